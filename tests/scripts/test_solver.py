"""What scripts/benchmarks/solver.py compares, on a small scene; no time is asserted."""

import warnings
from dataclasses import replace
from importlib import import_module
from types import ModuleType

import pytest
import torch

from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.estimation import image_space
from torchbrdf.estimation.classes import MaterialClasses, Mixture
from torchbrdf.light.probe import LightProbe


@pytest.fixture(scope="module")
def solver() -> ModuleType:
    return import_module("solver")


@pytest.fixture(scope="module")
def scene(solver: ModuleType, tiny_library: MaterialLibrary):
    """Three classes by hand: ten materials are too few to fit them."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made = solver.Scene.of(tiny_library, LightProbe.default(16), size=10, samples=64, repeats=1, count=16)
    shares = torch.nn.functional.one_hot(torch.arange(tiny_library.n) // 11).double()
    mixture = Mixture(shares.mean(0), torch.zeros(3, 4), torch.eye(4).repeat(3, 1, 1), shares, (0.0,), True)
    return replace(made, classes=MaterialClasses(mixture, tiny_library.names, tiny_library.source))


def errors(rows) -> dict[str, tuple[float, float]]:
    return {row.what: (row.fitted, row.novel) for row in rows if row.fitted is not None}


def test_every_driver_finds_the_factored_weights(solver: ModuleType, scene):
    found = errors(solver.against_lstsq(scene))
    assert len(found) == 10
    for driver in solver.DRIVERS:
        assert max(*found[f"lstsq, {driver}, looped"], *found[f"lstsq, {driver}, solves"]) < 1e-9


def test_a_wrong_solution_shows(solver: ModuleType, scene):
    """The error beside the time is no constant 0."""
    weights = scene.estimator()(scene.photographs[:2]).weights
    assert max(scene.apart(weights, weights)) == 0
    assert scene.apart(1.01 * weights, weights) == pytest.approx((0.01, 0.01), rel=1e-4)


def test_batches_and_masks_agree_with_their_references(solver: ModuleType, scene):
    assert max(max(pair) for pair in errors(solver.batches(scene)).values()) < 1e-3
    found = errors(solver.masks(scene))
    assert len(found) == 6
    assert max(max(pair) for what, pair in found.items() if "1 % left out" in what) < 1e-3


def test_truncation_leaves_the_default_as_it_was(solver: ModuleType, scene):
    before = image_space.CUT
    rows = list(solver.truncation(scene))
    assert before == image_space.CUT
    assert [row.what for row in rows if "the default" in row.remark] == [f"CUT = {before:.0e}"]
    assert rows[0].fitted == 0 < rows[-1].fitted


def test_skipping_changes_nothing_that_matters(solver: ModuleType, scene):
    found = errors(solver.skipped_priors(scene))
    assert max(found["above 1e-12"]) < 1e-9
    everything = scene.estimator().bank.explain(scene.pixels(4))
    one = solver.mean_weights(everything, 0.9)
    assert float((one - solver.mean_weights(everything)).abs().max()) > 0
    _, some = solver.skipped_classes(scene)
    assert some.remark.endswith("the same winner in 16 of 16")


def test_the_lower_bound_is_one(solver: ModuleType):
    """|Y w - y|^2 is never below it, and at the least squares solution it is reached to the margin."""
    g = torch.Generator().manual_seed(0)
    basis, y = (torch.rand(*shape, generator=g, dtype=torch.float64) for shape in ((4, 3, 30), (3, 30)))
    projection = torch.einsum("nsp,sp->sn", basis, y)
    bound = solver.lower_bound(solver.GramFactor.of(basis), projection, y.square().sum(-1))
    left = torch.linalg.lstsq(basis.permute(1, 2, 0), y[..., None]).solution[..., 0]
    least = float((torch.einsum("nsp,sn->sp", basis, left) - y).square().sum())
    assert bound < least < bound * (1 + 2 * solver.MARGIN)


def test_light_and_table(solver: ModuleType, scene):
    rows = list(solver.light_and_cells(scene, 16))
    assert all("of the cells touched" in row.remark for row in rows)
    lines = solver.table([*rows, solver.Row("a", "b", [0.002, 0.004, 0.003], 2, 1e-3, 2e-3, "c")]).splitlines()
    assert lines[-1] == "| a | b | 1.500 | 1.000-2.000 | 1.0e-03 | 2.0e-03 | c |"
