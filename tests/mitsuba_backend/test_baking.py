"""Basis images from Mitsuba: equal to the sampled ones within their own error estimates, resumable, deterministic."""

import re

import pytest
import torch
from safetensors.torch import load_file, save_file

from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.estimation.classes import MaterialClasses
from torchbrdf.estimation.estimator import BRDFEstimator
from torchbrdf.light.probe import LightProbe
from torchbrdf.mitsuba_backend import baking
from torchbrdf.mitsuba_backend.baking import bake_basis
from torchbrdf.rendering.basis import render_basis
from torchbrdf.transport.basis_images import BasisImages
from torchbrdf.view.normal_map import NormalMapView
from torchbrdf.view.sphere import SphereView

pytestmark = pytest.mark.usefixtures("mitsuba")
COUNTS = [2, 3, 7, 257]
SEEDS = range(16)


@pytest.fixture(scope="module")
def library(tiny_tables):
    return MaterialLibrary.from_tables([tiny_tables[name] for name in ("red", "teal", "satin-0.35", "steel-0.15")])


@pytest.fixture(scope="module")
def probe():
    return LightProbe.default(16)


@pytest.fixture(scope="module")
def truth(library, probe):
    """Sampled with so many samples that its own error (below 0.3 %) does not count."""
    return render_basis(library, probe, SphereView(8), samples=1 << 13).packed


def norms(packed):
    return packed.double().flatten(1).norm(dim=1)


def rms(values):
    return float(values.double().square().mean().sqrt())


@pytest.mark.parametrize("samples", COUNTS)
def test_the_error_estimate_is_the_error(library, probe, truth, samples):
    """Of single bakes against the truth, of two seeds against each other, and of the mean over the seeds."""
    bakes = [bake_basis(library, probe, SphereView(8), samples, seed) for seed in SEEDS]
    estimates = torch.stack([bake.relative_errors.double() * norms(bake.packed) for bake in bakes])
    errors = torch.stack([norms(bake.packed - truth) for bake in bakes])
    assert rms(errors) / rms(estimates) == pytest.approx(1, abs=0.15)
    pairs = torch.stack([norms(a.packed - b.packed) for a, b in zip(bakes[::2], bakes[1::2], strict=True)])
    assert rms(pairs) / rms(estimates) / 2**0.5 == pytest.approx(1, abs=0.15)

    mean = torch.stack([bake.packed for bake in bakes]).mean(0)
    assert (norms(mean - truth) < 2 * estimates.square().mean(0).sqrt() / len(SEEDS) ** 0.5).all()
    brightness = mean.sum((1, 2)) / truth.sum((1, 2))
    spread = estimates.square().mean(0).sqrt() / norms(truth) / (len(SEEDS) * truth[0].numel() / 3) ** 0.5
    assert ((brightness - 1).abs() < 6 * spread + 1e-3).all()


@pytest.mark.parametrize(
    "view",
    [SphereView(7, fov_deg=60), NormalMapView(SphereView(8).normals, SphereView(8).mask)],
    ids=["perspective", "normals"],
)
def test_other_views(library, probe, view):
    bake = render_basis(library, probe, view, backend="mitsuba", samples=2048, seed=3)
    sampled = render_basis(library, probe, view, samples=1 << 13)
    assert bake.view == view.fingerprint
    assert torch.equal(bake.mask, view.mask)
    errors = norms(bake.packed - sampled.packed) / norms(sampled.packed)
    assert rms(bake.relative_errors) < 0.05
    assert rms(errors) / rms(bake.relative_errors) == pytest.approx(1, abs=0.3)


def test_every_image_has_its_own_estimate(library, probe):
    """Images that are a multiple of each other have the same relative error, mirrors another than felt."""
    bake = bake_basis(library, probe, SphereView(8), 64)
    assert bake.relative_errors.shape == (12,)
    red, steel = bake.relative_errors[:3], bake.relative_errors[9:]
    torch.testing.assert_close(red, red[:1].expand(3), rtol=2e-3, atol=0)
    assert (steel > 1.02 * red).all() or (steel < red / 1.02).all()
    assert bake_basis(library, probe, SphereView(8), 4096).relative_errors.max() < 0.3 * red.min()


def test_a_seed_gives_the_same_images_again(library, probe):
    first, again, other = (
        render_basis(library, probe, SphereView(8), backend="mitsuba", samples=20, seed=seed) for seed in (4, 4, 5)
    )
    assert torch.equal(first.packed, again.packed)
    assert torch.equal(first.relative_errors, again.relative_errors)
    assert not torch.equal(first.packed, other.packed)


def test_seeds_do_not_share_their_passes(library, probe):
    """The passes of one seed are not those of the next one, moved."""
    one, two = (bake_basis(library, probe, SphereView(8), 2, seed).packed for seed in (0, 1))
    four = bake_basis(library, probe, SphereView(8), 4, 0).packed
    assert not torch.allclose(four, (one + two) / 2)


def test_fingerprints_and_description(library, probe):
    view = SphereView(8)
    bake = bake_basis(library, probe, view, 5, seed=2)
    sampled = render_basis(library, probe, view, samples=64)
    for field in ("library", "probe", "view", "names"):
        assert getattr(bake, field) == getattr(sampled, field)
    assert bake.packed.shape == sampled.packed.shape
    assert bake.packed.dtype == torch.float32
    assert "mitsuba" in bake.description
    assert "5 samples" in bake.description
    assert bake.normal_coverage == view.normal_coverage


def test_a_part_of_the_library(library, probe):
    """Dropping materials changes nothing in those that stay."""
    whole, part = (bake_basis(some, probe, SphereView(8), 9) for some in (library, library.without("teal")))
    assert part.names == ("red", "satin-0.35", "steel-0.15")
    torch.testing.assert_close(part.packed, whole.without("teal").packed)
    torch.testing.assert_close(part.relative_errors, whole.without("teal").relative_errors)


def test_blocks_of_paths_change_nothing_but_the_numbers(library, probe, truth, monkeypatch):
    monkeypatch.setattr(baking, "_PATHS_AT_ONCE", 500)
    bake = bake_basis(library, probe, SphereView(8), 1024)
    assert rms(norms(bake.packed - truth) / norms(truth)) < 2 * rms(bake.relative_errors)


# Interrupted bakes


def interrupted(monkeypatch, after, *arguments, **options):
    """Ctrl-C in the pass after some."""
    calls = []
    render_pass = baking._render_pass

    def stop(*args):
        calls.append(1)
        if len(calls) > after:
            raise KeyboardInterrupt
        return render_pass(*args)

    with monkeypatch.context() as patch:
        patch.setattr(baking, "_render_pass", stop)
        with pytest.raises(KeyboardInterrupt):
            bake_basis(*arguments, **options)


@pytest.mark.parametrize("after", [1, 3, 8])
def test_a_bake_goes_on_where_it_was_interrupted(library, probe, monkeypatch, tmp_path, after):
    state, arguments = tmp_path / "state", (library, probe, SphereView(8), 100, 6)
    interrupted(monkeypatch, after, *arguments, state=state)
    assert state.is_file()
    assert [path.name for path in tmp_path.iterdir()] == ["state"]
    counts = []
    render_pass = baking._render_pass
    monkeypatch.setattr(baking, "_render_pass", lambda *args: counts.append(args[2]) or render_pass(*args))
    resumed = bake_basis(*arguments, state=state)
    assert 0 < sum(counts) <= 100 - 12 * after
    counts.clear()
    whole = bake_basis(*arguments)
    assert sum(counts) == 100
    assert torch.equal(resumed.packed, whole.packed)
    assert torch.equal(resumed.relative_errors, whole.relative_errors)
    counts.clear()
    assert torch.equal(bake_basis(*arguments, state=state).packed, whole.packed)
    assert not counts


def test_interrupted_twice_and_before_the_first_pass(library, probe, monkeypatch, tmp_path):
    state, arguments = tmp_path / "state", (library, probe, SphereView(8), 100, 6)
    interrupted(monkeypatch, 0, *arguments, state=state)
    interrupted(monkeypatch, 2, *arguments, state=state)
    interrupted(monkeypatch, 2, *arguments, state=state)
    assert torch.equal(bake_basis(*arguments, state=state).packed, bake_basis(*arguments).packed)


@pytest.mark.parametrize("what", ["seed", "samples", "probe", "view", "library"])
def test_the_state_of_another_bake_is_refused(library, probe, monkeypatch, tmp_path, what):
    arguments = {"library": library, "probe": probe, "view": SphereView(8), "samples": 100, "seed": 6}
    state = tmp_path / "state"
    interrupted(monkeypatch, 2, **arguments, state=state)
    before = state.read_bytes()
    tables = [library.table(name) for name in ("red", "teal")]
    others = {"seed": 7, "samples": 101, "probe": probe.scaled(2), "view": SphereView(8, fov_deg=30)}
    arguments[what] = MaterialLibrary.from_tables(tables) if what == "library" else others[what]
    with pytest.raises(ValueError, match=r"^[^\n]*another bake[^\n]*$") as caught:
        bake_basis(**arguments, state=state)
    assert str(caught.value).startswith(f"{state}: ")
    assert state.read_bytes() == before


LOST: dict[str, dict[str, torch.Tensor]] = {
    "wrong shape": {"mean": torch.zeros(3, 2, 30)},
    "wrong type": {"spread": torch.zeros(30)},
    "one count": {"counts": torch.tensor(64)},
    "no pass": {"counts": torch.tensor([0, 0])},
    "more passes than samples": {"counts": torch.tensor([2, 3])},
    "another tensor": {"more": torch.zeros(1)},
    "not a number": {"spread": torch.full((30,), torch.nan, dtype=torch.float64)},
    "negative": {"spread": torch.full((30,), -1.0, dtype=torch.float64)},
}


@pytest.mark.parametrize("damage", ["cut", "noise", "empty", "foreign", "basis", "tensor lost", *LOST])
def test_a_damaged_state_is_refused(library, probe, monkeypatch, tmp_path, damage):
    state, arguments = tmp_path / "state", (library, probe, SphereView(8), 100, 6)
    interrupted(monkeypatch, 2, *arguments, state=state)
    content, tensors = state.read_bytes(), load_file(state)
    if damage == "cut":
        state.write_bytes(content[: len(content) // 2])
    elif damage == "noise":
        state.write_bytes(bytes(range(256)) * 8)
    elif damage == "empty":
        state.write_bytes(b"")
    elif damage == "foreign":
        save_file(tensors, state)
    elif damage == "basis":
        bake_basis(library, probe, SphereView(8), 2).save(state)
    else:
        from safetensors import safe_open

        with safe_open(state, "pt") as file:
            metadata = file.metadata()
        changed = {key: tensor for key, tensor in tensors.items() if key != "counts"}
        if damage in LOST:
            changed = tensors | LOST[damage]
        save_file(changed, state, metadata)
    with pytest.raises(ValueError, match=rf"^{re.escape(str(state))}: [^\n]*delete[^\n]*$"):
        bake_basis(*arguments, state=state)


def test_progress_is_shown_and_else_nothing(library, probe, capfd, monkeypatch):
    monkeypatch.setattr("torchbrdf.progress._draws", lambda _: True)
    bake_basis(library, probe, SphereView(8), 100)
    assert capfd.readouterr() == ("", "")
    bake_basis(library, probe, SphereView(8), 100, progress=True)
    assert re.search("baking.*100/100", capfd.readouterr().err)


# What is done with the result


def test_relative_errors_survive(library, probe, tmp_path):
    bake = bake_basis(library, probe, SphereView(8), 30)
    bake.save(tmp_path / "basis.safetensors")
    loaded = BasisImages.load(tmp_path / "basis.safetensors", library, probe, SphereView(8))
    assert torch.equal(loaded.packed, bake.packed)
    assert loaded.normal_coverage == bake.normal_coverage
    for same in (loaded, bake.to("cpu"), bake.to(torch.device("cpu"))):
        assert torch.equal(same.relative_errors, bake.relative_errors)
    rows = [9, 10, 11, 0, 1, 2]
    assert torch.equal(bake.subset(["steel-0.15", "red"]).relative_errors, bake.relative_errors[rows])
    assert torch.equal(bake.without("teal", "satin-0.35").relative_errors, bake.relative_errors[sorted(rows)])
    render_basis(library, probe, SphereView(8), samples=64).save(tmp_path / "none.safetensors")
    assert BasisImages.load(tmp_path / "none.safetensors").relative_errors is None


def test_a_saved_bake_fits_a_photograph(tiny_library, probe, tmp_path):
    view, classes = SphereView(8), MaterialClasses.fit(tiny_library, n_classes=2, n_dims=2)
    bake_basis(tiny_library, probe, view, 1024).save(tmp_path / "b.safetensors")
    estimator = BRDFEstimator(BasisImages.load(tmp_path / "b.safetensors", tiny_library, probe, view), classes)
    photograph = render_basis(tiny_library, probe, view, samples=1 << 12).image("satin-0.35")
    result = estimator(photograph)
    assert (result.image - photograph).norm() / photograph.norm() < 0.03
    table, expected = result.brdf(tiny_library), tiny_library.table("satin-0.35")
    valid = expected.valid
    assert (table.values[valid].mean(0) / expected.values[valid].mean(0) - 1).abs().max() < 0.25


@pytest.mark.parametrize("samples", [-1, 0, 1])
def test_too_few_samples(library, probe, samples):
    with pytest.raises(ValueError, match=rf"^baking needs at least 2 samples[^\n]*got {samples}$"):
        render_basis(library, probe, SphereView(8), backend="mitsuba", samples=samples)


def test_samples_are_whole(library, probe):
    with pytest.raises(ValueError, match=r"^samples must be a whole number, got 2\.5$"):
        render_basis(library, probe, SphereView(8), backend="mitsuba", samples=2.5)


def test_a_probe_without_energy():
    with pytest.raises(ValueError, match=r"^light probe has no energy: every texel is 0; [^\n]*$"):
        LightProbe(torch.zeros(3, 8, 16))
