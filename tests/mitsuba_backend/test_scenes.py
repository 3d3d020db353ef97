"""`MitsubaScene`: the same picture as the package's own transport, with noise that its two halves tell."""

import numpy as np
import pytest
import torch

import torchbrdf as tb
from materials import lambert
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.light.probe import LightProbe
from torchbrdf.mitsuba_backend import merl_bsdf, scenes
from torchbrdf.mitsuba_backend.scenes import HalfRenderings, MitsubaScene
from torchbrdf.view.normal_map import NormalMapView
from torchbrdf.view.sphere import SphereView
from turns import turn_about

pytestmark = pytest.mark.usefixtures("mitsuba")


@pytest.fixture(scope="module")
def probe():
    """Lit from everywhere, unlike in all directions and colours."""
    side = torch.linspace(0.2, 2, 32)
    return LightProbe(side * (0.2 + torch.rand(3, 16, 32, generator=torch.Generator().manual_seed(0)) ** 4))


@pytest.fixture(scope="module")
def grey():
    return MerlTable.from_function(lambert(0.8, 0.5, 0.2), "grey")


@pytest.mark.parametrize("fov_deg", [None, 25.0, 80.0])
@pytest.mark.parametrize("material", ["satin-0.35", "steel-0.15"])
def test_a_sphere_renders_like_the_transport(tiny_tables, probe, fov_deg, material):
    view, table = SphereView(8, fov_deg=fov_deg), tiny_tables[material]
    ours = tb.render(table, probe, view, samples=4096)
    halves = MitsubaScene(view, probe, table).render_halves(16384)
    assert (halves.image - ours).norm() / ours.norm() < 1.3 * halves.noise + 0.003
    assert halves.noise < 0.02
    mirrored = tb.render(table, probe, view, samples=512).flip(-1)
    assert (halves.image - mirrored).norm() / ours.norm() > 5 * halves.noise


def test_outside_the_mask_all_is_zero(probe, grey):
    view = SphereView(8)
    picture = MitsubaScene(view, probe, grey).render(16)
    assert picture.shape == (3, 8, 8)
    assert picture.dtype == torch.float32
    assert not picture[:, ~view.mask[0]].any()
    assert (picture[:, view.mask[0]] > 0).all()


def test_the_noise_of_two_halves_is_the_error(probe, grey):
    view = SphereView(8)
    scene = MitsubaScene(view, probe, grey)
    truth = scene.render(1 << 16, seed=99)
    halves = [scene.render_halves(64, seed) for seed in range(12)]
    errors = torch.tensor([float((half.image - truth).norm() / truth.norm()) for half in halves])
    estimates = torch.tensor([half.noise for half in halves])
    assert float((errors.square().mean() / estimates.square().mean()).sqrt()) == pytest.approx(1, abs=0.1)
    assert all(not torch.equal(half.first, half.second) for half in halves)
    firsts = torch.stack([part for half in halves for part in (half.first, half.second)])
    assert len(torch.unique(firsts.flatten(1), dim=0)) == 24


def test_halves_by_hand():
    first, second = torch.full((3, 2, 2), 1.0), torch.full((3, 2, 2), 3.0)
    halves = HalfRenderings(first, second)
    assert torch.equal(halves.image, torch.full((3, 2, 2), 2.0))
    assert halves.noise == pytest.approx(0.5)


def test_seeds(probe, grey):
    scene = MitsubaScene(SphereView(6), probe, grey)
    first, again, other = (scene.render(8, seed) for seed in (1, 1, 2))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


@pytest.mark.parametrize("samples", [1, 5, 8])
def test_renderings_in_parts_weigh_every_sample_alike(probe, grey, monkeypatch, samples):
    """Three samples at once: the parts are independent and the last one may be smaller."""
    scene = MitsubaScene(SphereView(6), probe, grey)
    monkeypatch.setattr(scenes, "_PATHS_AT_ONCE", 3 * 36)
    counts = []
    render = scene._mi.render

    class Counted:
        def __getattr__(self, name):
            return getattr(module, name)

        def render(self, *args, **options):
            counts.append((options["spp"], options["seed"]))
            return render(*args, **options)

    module, scene._mi = scene._mi, Counted()
    picture = scene.render(samples)
    assert [count for count, _ in counts] == {1: [1], 5: [3, 2], 8: [3, 3, 2]}[samples]
    assert len({seed for _, seed in counts}) == len(counts)
    expected = sum(count * np.array(render(scene.scene, spp=count, seed=seed)) for count, seed in counts) / samples
    inside = scene.view.mask[0]
    torch.testing.assert_close(picture[:, inside], torch.from_numpy(expected).permute(2, 0, 1).float()[:, inside])


def test_any_bsdf_and_integrator(probe, grey):
    view = SphereView(6)
    diffuse = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.5, 0.2]}}
    pictures = [MitsubaScene(view, probe, bsdf).render(4096) for bsdf in (grey, merl_bsdf(grey, "linear"), diffuse)]
    pictures.append(MitsubaScene(view, probe, grey, {"type": "path"}).render(4096))
    for picture in pictures[1:]:
        assert (picture - pictures[0]).norm() / pictures[0].norm() < 0.02


def test_set_table(probe, grey, tiny_tables):
    view = SphereView(6)
    scene = MitsubaScene(view, probe, grey)
    before = scene.render(32)
    scene.set_table(tiny_tables["red"])
    torch.testing.assert_close(scene.render(32), MitsubaScene(view, probe, tiny_tables["red"]).render(32))
    scene.set_table(grey)
    torch.testing.assert_close(scene.render(32), before)


def test_set_table_needs_the_plugin(probe, grey):
    scene = MitsubaScene(SphereView(6), probe, {"type": "diffuse"})
    with pytest.raises(ValueError, match=r"^[^\n]*merl[^\n]*$"):
        scene.set_table(grey)


def test_a_view_without_a_shape(probe, grey):
    view = NormalMapView(SphereView(8).normals)
    with pytest.raises(ValueError, match=r"^[^\n]*NormalMapView[^\n]*; give a SphereView or a MeshView$"):
        MitsubaScene(view, probe, grey)


@pytest.mark.parametrize("samples", [0, -1])
@pytest.mark.filterwarnings("error")
def test_too_few_samples(probe, grey, samples):
    scene = MitsubaScene(SphereView(6), probe, grey)
    with pytest.raises(ValueError, match=rf"^[^\n]*sample[^\n]*got {samples}$"):
        scene.render(samples)
    with pytest.raises(ValueError, match=rf"^two halves need at least 2 samples a pixel, got {samples}$"):
        scene.render_halves(samples)


def test_samples_are_whole(probe, grey):
    scene = MitsubaScene(SphereView(6), probe, grey)
    with pytest.raises(ValueError, match=r"^samples must be a whole number, got 2\.5$"):
        scene.render(2.5)


@pytest.mark.parametrize("columns", [3, -8, 16])
def test_a_light_turned_by_whole_texels(probe, tiny_tables, columns):
    """About +Y it is the rotated probe, whose radiance is the same at every texel."""
    view, table = SphereView(8), tiny_tables["steel-0.15"]
    rotation = turn_about((0, 1, 0), -columns * 360 / 32)
    turned = MitsubaScene(view, probe, table, rotation=rotation).render_halves(16384)
    expected = MitsubaScene(view, probe.rotated(rotation), table).render_halves(16384, seed=7)
    noise = (turned.noise**2 + expected.noise**2) ** 0.5
    assert noise < 0.03
    assert (turned.image - expected.image).norm() / expected.image.norm() < 1.4 * noise
    for others in (0, -columns, columns + 1):
        elsewhere = MitsubaScene(view, LightProbe(probe.radiance.roll(others, -1)), table).render(4096)
        if (others - columns) % 32:
            assert (turned.image - elsewhere).norm() / elsewhere.norm() > 4 * noise


@pytest.mark.parametrize(("axis", "degrees"), [((1, 0, 0), 50), ((0, 0, 1), -75), ((1, -2, 1.5), 130)])
def test_a_light_turned_about_any_axis(tiny_tables, axis, degrees):
    """As `LightProbe.rotated` and our own transport show it; the rotation the other way round is another picture."""
    view, table, room = SphereView(8), tiny_tables["gold-0.3"], LightProbe.default(32)
    rotation = turn_about(axis, degrees)
    turned = MitsubaScene(view, room, table, rotation=rotation).render_halves(8192)
    ours = tb.render(table, room.rotated(rotation), view, samples=2048)
    assert (turned.image - ours).norm() / ours.norm() < 0.03
    other = tb.render(table, room.rotated(rotation.T), view, samples=256)
    assert (turned.image - other).norm() / ours.norm() > 0.2


def test_a_light_that_is_not_turned(probe, grey):
    view = SphereView(6)
    plain = MitsubaScene(view, probe, grey).render(32)
    for rotation in (None, torch.eye(3), torch.eye(3, dtype=torch.float64)):
        torch.testing.assert_close(MitsubaScene(view, probe, grey, rotation=rotation).render(32), plain)


def test_a_light_turned_by_what_is_no_rotation(probe, grey):
    message = r"^rotation must be orthonormal with determinant \+1, got determinant -1 and [^\n]*$"
    with pytest.raises(ValueError, match=message):
        MitsubaScene(SphereView(6), probe, grey, rotation=torch.diag(torch.tensor([1.0, 1.0, -1.0])))
