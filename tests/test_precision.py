"""The public calls give what they give alone, whatever precision torch is told to prefer around them."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from textwrap import dedent

import pytest
import torch
from torch import Tensor

import torchbrdf as tb
from coarse_grids import COARSE, computed_on
from paths import ROOT
from torchbrdf.alignment import LearnedRotation
from torchbrdf.images import converted
from torchbrdf.lasting import without_autocast
from torchbrdf.learning import RandomProbeRotation, ReflectanceMaps, mask_reflection, rotate_probes
from torchbrdf.light._procedural import studio_room
from torchbrdf.transport.harmonic import HarmonicBasis
from torchbrdf.transport.harmonic.cache import transport_of
from turns import turn_about

TURN = turn_about((1, 2, -0.5), 25)
ASIDE = (0.3, 0.2, -1.0)


@dataclass(frozen=True)
class Capture:
    """A photograph of a mixture and what explains it, made where torch prefers nothing."""

    materials: Path

    @cached_property
    def library(self) -> tb.MaterialLibrary:
        made = tb.MaterialLibrary.from_merl(self.materials, progress=False)
        transport_of(made)
        return made

    @cached_property
    def probe(self) -> tb.LightProbe:
        return tb.LightProbe.default(32)

    @cached_property
    def view(self) -> tb.SphereView:
        return tb.SphereView(16)

    @cached_property
    def basis(self) -> tb.BasisImages:
        return tb.render_basis(self.library, self.probe, self.view, samples=64)

    @cached_property
    def table(self) -> tb.MerlTable:
        return self.library.combine(self.weights)

    @cached_property
    def weights(self) -> Tensor:
        drawn = torch.rand(self.library.n, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
        return drawn / self.library.n

    @cached_property
    def photograph(self) -> Tensor:
        return tb.render(self.table, self.probe, self.view, samples=64)

    @cached_property
    def classes(self) -> tb.MaterialClasses:
        return tb.MaterialClasses.fit(self.library, n_classes=2, n_dims=2)

    @cached_property
    def result(self) -> tb.Reconstruction:
        return self.estimate()

    def estimate(self, **settings: object) -> tb.Reconstruction:
        return tb.BRDFEstimator(self.basis, self.classes, **settings)(self.photograph)


SHORT = {"most_evaluations": 8}
"""A search that ends before it has forgotten where its sums were rounded."""


def parameters(fit: tb.AnalyticFit) -> Tensor:
    return torch.cat(list(fit.parameters.values()))


Calls = dict[str, Tensor]

CALLS: dict[str, Callable[[Capture], Tensor]] = {
    "probe": lambda of: tb.LightProbe.default(32).radiance,
    "rotated": lambda of: of.probe.rotated(TURN).radiance,
    "resized": lambda of: of.probe.resized(20).radiance,
    "blurred": lambda of: of.probe.blurred(5).radiance,
    "sampled": lambda of: of.probe.sample(torch.full((4, 2), 0.3))[0],
    "pdf": lambda of: of.probe.pdf(tb.SphereView(16).normals[:, 8, 8]),
    "converted": lambda of: converted(of.probe.radiance, "rec709", "rec2020"),
    "rotate_probes": lambda of: rotate_probes(of.probe.radiance, TURN),
    "RandomProbeRotation": lambda of: RandomProbeRotation()(of.probe.radiance[None], params={"rotation": TURN[None]}),
    "mask_reflection": lambda of: mask_reflection(tb.SphereView(64), 20, (0.3, 0.2, 1)),
    "ReflectanceMaps": lambda of: ReflectanceMaps(of.basis)[:5]["clean"],
    "view": lambda of: tb.SphereView(16).normals,
    "view, off the axis": lambda of: tb.SphereView(16, fov_deg=15, direction=ASIDE).normals,
    "view_dirs, off the axis": lambda of: tb.SphereView(16, fov_deg=15, direction=ASIDE).view_dirs,
    "render": lambda of: tb.render(of.table, of.probe, tb.SphereView(16)),
    "render, sampled": lambda of: tb.render(of.table, of.probe, tb.SphereView(16), samples=64),
    "render, sampled, off the axis": lambda of: tb.render(
        of.table, of.probe, tb.SphereView(16, fov_deg=15, direction=ASIDE), samples=64
    ),
    "render_basis": lambda of: tb.render_basis(of.library, of.probe, tb.SphereView(16)).packed,
    "render_basis, sampled": lambda of: tb.render_basis(of.library, of.probe, tb.SphereView(16), samples=64).packed,
    "basis_at": lambda of: HarmonicBasis(of.library, of.probe, of.view).basis_at(TURN).packed,
    "image_at": lambda of: HarmonicBasis(of.library, of.probe, of.view).image_at(of.weights, TURN),
    "images_of": lambda of: HarmonicBasis(of.library, of.probe, of.view).images_of(of.weights[None]),
    "change_at": lambda of: HarmonicBasis(of.library, of.probe, of.view).change_at(of.weights, TURN),
    "classes": lambda of: tb.MaterialClasses.fit(of.library, n_classes=2, n_dims=2).responsibilities,
    "weights": lambda of: of.estimate().weights,
    "image": lambda of: of.estimate().image,
    "robust": lambda of: of.estimate(robust=True).image,
    "fixed penalty": lambda of: of.estimate(penalty="paper").weights,
    "energy": lambda of: of.estimate(constraint="energy", library=of.library).weights,
    "lobes": lambda of: of.estimate(constraint="lobes", library=of.library).weights,
    "relative_error": lambda of: of.estimate().relative_error,
    "brdf": lambda of: of.result.brdf(of.library).values,
    "brdf_std": lambda of: of.result.brdf_std(of.library),
    "image_std": lambda of: of.result.image_std(of.basis),
    "observability": lambda of: tb.BRDFEstimator(of.basis, of.classes).observability(of.library).seen,
    "rehearse": lambda of: torch.tensor([tb.BRDFEstimator(of.basis, of.classes).rehearse([of.basis]).error]).double(),
    "fit_analytic": lambda of: parameters(tb.fit_analytic(of.table, "ggx", **SHORT)),
    "fit_analytic_to_image": lambda of: parameters(
        tb.fit_analytic_to_image(of.photograph, of.probe, of.view, "ggx", **SHORT)
    ),
    "align": lambda of: tb.align(of.photograph, of.probe, of.view, of.library).rotation,
    "LearnedRotation": lambda of: LearnedRotation(HarmonicBasis(of.library, of.probe, of.view), TURN)(of.weights),
}


@contextmanager
def autocast() -> Iterator[None]:
    with torch.autocast("cpu", dtype=torch.bfloat16):
        yield


@contextmanager
def float64_by_default() -> Iterator[None]:
    torch.set_default_dtype(torch.float64)
    try:
        yield
    finally:
        torch.set_default_dtype(torch.float32)


AROUND = [
    pytest.param(name, around, id=f"{name}-{around.__name__}")
    for around in (autocast, float64_by_default)
    for name in CALLS
]


@pytest.fixture(scope="module")
def capture(tiny_tables: dict[str, tb.MerlTable], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Capture]:
    folder = tmp_path_factory.mktemp("materials")
    for name in ("red", "satin-0.35", "gold-0.3", "steel-0.15"):
        tiny_tables[name].save(folder / f"{name}.binary")
    with computed_on(COARSE):  # which is fine enough to see whether two pictures are the same
        made = Capture(folder)
        assert torch.isfinite(made.result.weights).all()
        yield made


@pytest.fixture(scope="module")
def alone(capture: Capture) -> Calls:
    return {name: call(capture) for name, call in CALLS.items()}


@pytest.mark.parametrize(("name", "around"), AROUND)
def test_a_call_gives_what_it_gives_alone(capture: Capture, alone: Calls, name: str, around) -> None:
    with around():
        found = CALLS[name](capture)
    assert found.dtype == alone[name].dtype
    torch.testing.assert_close(found, alone[name], rtol=1e-5, atol=1e-6, equal_nan=True)


@pytest.fixture(scope="module")
def float64_first(capture: Capture, tmp_path_factory: pytest.TempPathFactory) -> Calls:
    """What the calls give in a process that sets the default type before all else, with an empty cache."""
    folder = tmp_path_factory.mktemp("float64_first")
    code = """
        import pathlib, sys, torch
        torch.set_default_dtype(torch.float64)
        import coarse_grids, test_precision
        with coarse_grids.computed_on(coarse_grids.COARSE):
            capture = test_precision.Capture(pathlib.Path(sys.argv[1]))
            found = {name: call(capture).detach() for name, call in test_precision.CALLS.items()}
        torch.save(found, sys.argv[2])
    """
    path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    environment = {**os.environ, "TORCHBRDF_CACHE": str(folder / "cache"), "PYTHONPATH": path}
    command = [sys.executable, "-c", dedent(code), str(capture.materials), str(folder / "found.pt")]
    subprocess.run(command, env=environment, check=True)
    found: Calls = torch.load(folder / "found.pt")
    return found


@pytest.mark.parametrize("name", CALLS)
def test_a_call_gives_the_same_where_the_default_type_was_set_first(
    float64_first: Calls, alone: Calls, name: str
) -> None:
    assert float64_first[name].dtype == alone[name].dtype
    torch.testing.assert_close(float64_first[name], alone[name], rtol=1e-5, atol=1e-6, equal_nan=True)


def test_a_light_first_made_under_autocast_is_as_bright(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    expected = tb.LightProbe.default(24).radiance
    studio_room.cache_clear()
    monkeypatch.setenv("TORCHBRDF_CACHE", str(tmp_path))
    with autocast():
        found = tb.LightProbe.default(24).radiance
    assert torch.equal(found, expected)


def test_autocast_goes_on_after_a_call() -> None:
    ones = torch.ones(2, 2)
    with autocast():
        assert without_autocast(torch.mm)(ones, ones).dtype == torch.float32
        assert torch.mm(ones, ones).dtype == torch.bfloat16
