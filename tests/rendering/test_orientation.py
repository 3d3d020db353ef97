"""Mitsuba's orientation and ours are one: proven by probes with one bright texel at known directions.

Every direction is written out by hand from the convention, none comes from the code under test.
"""

from collections.abc import Iterator
from math import cos, pi, sin
from types import ModuleType

import numpy as np
import pytest
import torch

import torchbrdf as tb
from materials import TINY_MATERIALS
from torchbrdf import Camera, MeshView
from torchbrdf.images.difference import relative_rms
from torchbrdf.mitsuba_backend.scenes import MitsubaScene, light
from torchbrdf.threads import one_thread

HEIGHT, WIDTH = 24, 48
TEXELS = [(5, 9), (14, 3), (8, 30), (17, 41), (3, 20), (11, 0), (12, 47), (0, 7), (23, 33)]
"""Row and column: on both sides of each axis, none a mirror image of another, beside the seam, and at both poles."""

LIGHTS = [(5, 9), (14, 15), (8, 30), (16, 29)]
"""Above and below, to the right and to the left; the first stands behind the object."""


@pytest.fixture
def mi(mitsuba: ModuleType) -> ModuleType:
    return mitsuba


def one_texel(row: int, column: int, background: float = 0.0) -> tb.LightProbe:
    radiance = torch.full((3, HEIGHT, WIDTH), background)
    radiance[:, row, column] = torch.tensor([40.0, 50.0, 60.0])
    return tb.LightProbe(radiance)


def direction_of(row: int, column: int) -> np.ndarray:
    phi, theta = 2 * pi * (column + 0.5) / WIDTH, pi * row / (HEIGHT - 1)
    return np.array([sin(phi) * sin(theta), cos(theta), -cos(phi) * sin(theta)])


def seen_by_mitsuba(mi, probe: tb.LightProbe, directions: np.ndarray) -> np.ndarray:
    import drjit as dr

    hit = dr.zeros(mi.SurfaceInteraction3f)
    hit.wi = mi.Vector3f(*(np.ascontiguousarray(-axis, np.float32) for axis in directions.T))
    return np.array(mi.load_dict(light(mi, probe)).eval(hit)).T


def seen_by_us(probe: tb.LightProbe, directions: np.ndarray) -> np.ndarray:
    return probe.radiance_at(torch.from_numpy(directions.astype(np.float32))).numpy()


@pytest.fixture(scope="module")
def directions() -> np.ndarray:
    """(N, 3) unit vectors: all over the sphere, near the poles, near the seam at -Z, and the axes but for the poles.

    None is within 1e-3 of a pole, where Mitsuba's float32 acos rounds the angle by more than a thousandth of a texel.
    """
    rng = np.random.default_rng(0)
    everywhere = rng.normal(size=(20000, 3))
    poles = np.stack([*rng.normal(size=(2, 2000)) * 0.02, rng.choice([-1.0, 1.0], 2000)])[[0, 2, 1]].T
    seam = np.stack([rng.normal(size=2000) * 0.02, rng.normal(size=2000), -np.abs(rng.normal(size=2000))]).T
    axes = np.array([[1, 0, 0], [0, 0, 1], [-1, 0, 0], [0, 0, -1]])
    found = np.concatenate([everywhere, poles, seam, axes])
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    return found[np.hypot(found[:, 0], found[:, 2]) > 1e-3]


@pytest.mark.parametrize("texel", TEXELS)
def test_a_bright_texel_is_seen_in_its_direction_by_both(mi, directions, texel):
    probe = one_texel(*texel)
    towards = direction_of(*texel)[None]
    expected = np.array([[40.0, 50.0, 60.0]])
    if texel[0] in (0, HEIGHT - 1):  # at a pole, where all columns meet, only the side of approach tells them apart
        towards = direction_of(texel[0] + (1e-4 if texel[0] == 0 else -1e-4), texel[1])[None]
    np.testing.assert_allclose(seen_by_us(probe, towards), expected, rtol=2e-3)
    np.testing.assert_allclose(seen_by_mitsuba(mi, probe, towards), expected, rtol=2e-3)
    np.testing.assert_allclose(seen_by_us(probe, directions), seen_by_mitsuba(mi, probe, directions), atol=60 * 5e-4)


@pytest.mark.parametrize("texel", TEXELS)
def test_other_directions_are_dark(mi, texel):
    """Mirrored or turned, the texel is not there: the test above fails for any other convention."""
    x, y, z = direction_of(*texel)
    others = np.array([[-x, y, z], [x, -y, z], [x, y, -z], [z, y, x], [-z, y, x], [y, z, x]])
    far = others[others @ [x, y, z] < cos(1.5 * pi / (HEIGHT - 1))]
    if texel[0] not in (0, HEIGHT - 1):
        assert len(far) >= 3
    probe = one_texel(*texel)
    assert np.abs(seen_by_us(probe, far)).max() == 0
    assert np.abs(seen_by_mitsuba(mi, probe, far)).max() == 0


def test_noise_is_seen_alike_everywhere(mi, directions):
    """To the rounding of float32 angles."""
    probe = tb.LightProbe(torch.rand(3, HEIGHT, WIDTH, generator=torch.Generator().manual_seed(1)))
    ours, theirs = seen_by_us(probe, directions), seen_by_mitsuba(mi, probe, directions)
    np.testing.assert_allclose(ours, theirs, atol=5e-4)
    calm = np.hypot(directions[:, 0], directions[:, 2]) > 0.1
    np.testing.assert_allclose(ours[calm], theirs[calm], atol=2e-5)
    for flipped in (probe.radiance.flip(-1), probe.radiance.flip(-2), probe.radiance.roll(1, -1)):
        other = seen_by_mitsuba(mi, tb.LightProbe(flipped), directions)
        assert np.abs(other - theirs).max() > 0.5, "the check sees a flipped and a turned map"


@pytest.mark.parametrize("pole", [0, -1])
def test_the_poles(mi, pole):
    """Where the texels of a pole are alike, as in a photograph, both see them there exactly."""
    radiance = torch.zeros(3, HEIGHT, WIDTH)
    radiance[:, pole] = torch.tensor([1.0, 2.0, 3.0])[:, None]
    probe, towards = tb.LightProbe(radiance), np.array([[0.0, 1.0 if pole == 0 else -1.0, 0.0]])
    for direction, expected in ((towards, [[1.0, 2.0, 3.0]]), (-towards, [[0.0, 0.0, 0.0]])):
        np.testing.assert_allclose(seen_by_us(probe, direction), expected, atol=1e-6)
        np.testing.assert_allclose(seen_by_mitsuba(mi, probe, direction), expected, atol=1e-6)


@pytest.fixture(scope="module")
def steel() -> tb.MerlTable:
    return tb.MerlTable.from_function(TINY_MATERIALS["steel-0.15"], "steel")


@pytest.fixture
def few_threads() -> Iterator[None]:
    """The threads of torch would wait for work by spinning, beside those of Mitsuba."""
    with one_thread():
        yield


def assert_alike(table: tb.MerlTable, probe: tb.LightProbe, view: tb.View) -> tuple[torch.Tensor, torch.Tensor]:
    """Our rendering and Mitsuba's are equal within their noise, and a mirrored probe's is not."""
    ours = tb.render(table, probe, view, samples=1024)
    halves = MitsubaScene(view, probe, table).render_halves(8192)
    theirs = halves.image
    assert relative_rms(ours, theirs, view.mask) < 0.01 + 2 * halves.noise < 0.06
    assert float(ours.mean() / theirs.mean()) == pytest.approx(1, abs=0.01)
    turned = tb.render(table, tb.LightProbe(probe.radiance.flip(-1)), view, samples=64)
    assert relative_rms(turned, theirs, view.mask) > 0.5
    return ours, theirs


def highlight(image: torch.Tensor) -> tuple[float, float]:
    """Column and row of the middle of what is brighter than half the brightest pixel, in pixels from the corner."""
    green = image[1].double()
    bright = torch.where(green > 0.5 * green.max(), green, 0)
    size = torch.arange(len(green), dtype=torch.float64) + 0.5
    return float((bright.sum(0) * size).sum() / bright.sum()), float((bright.sum(1) * size).sum() / bright.sum())


@pytest.mark.parametrize("texel", LIGHTS)
@pytest.mark.usefixtures("mi", "few_threads")
def test_a_glossy_ball_is_rendered_alike_with_its_highlight_in_place(steel, texel):
    """The normal at the highlight halves the angle of light and camera (0, 0, 1); on a unit sphere it is the place."""
    images = assert_alike(steel, one_texel(*texel, background=0.05), tb.SphereView(24))
    half = direction_of(*texel) + np.array([0, 0, 1])
    x, y, _ = half / np.linalg.norm(half)
    for image in images:
        assert highlight(image) == pytest.approx(((1 + x) * 12, (1 - y) * 12), abs=0.7)


@pytest.mark.usefixtures("mi", "few_threads")
def test_a_tilted_shape_before_a_tilted_camera_is_rendered_alike(steel, tmp_path):
    """An ellipsoid with three different axes, turned and away from the origin."""
    trimesh = pytest.importorskip("trimesh")
    shape = trimesh.creation.icosphere(3)
    shape.apply_scale([1.0, 0.7, 0.5])
    shape.apply_transform(trimesh.transformations.rotation_matrix(0.8, [0.3, 1.0, -0.5], point=[0.5, 0.2, -0.1]))
    shape.export(tmp_path / "egg.ply", vertex_normal=True)
    view = MeshView(tmp_path / "egg.ply", 24, Camera(toward=(0.9, 0.5, 0.6), up=(0.2, 1.0, -0.3), fov_deg=30.0))
    assert_alike(steel, one_texel(6, 21, background=0.05), view)
