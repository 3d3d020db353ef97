"""Clear skies: direction, colour and power are those of Mitsuba's `sunsky`, which also renders by itself here."""

import re
from math import cos, pi, radians, sin
from types import ModuleType

import numpy as np
import pytest
import torch

import torchbrdf as tb
from torchbrdf.light import _sky as sky_module
from torchbrdf.mitsuba_backend.scenes import light, sensor
from torchbrdf.mitsuba_startup.loading import load_mitsuba

CD_PER_UNIT = 683 * 106.75
"""683 lm/W times the integral of the luminous efficiency in nm."""

NORMALS = [[0, 1, 0], [0.3, 0.8, 0.5], [-1, 0.2, 0.3], [0, 0, 1], [1, 0, -0.1], [0.1, -0.3, 1]]


@pytest.fixture
def mi(mitsuba: ModuleType) -> ModuleType:
    return mitsuba


def towards_sun(elevation: float, azimuth: float) -> np.ndarray:
    """The convention, written out by hand."""
    e, phi = radians(elevation), radians(azimuth)
    return np.array([sin(phi) * cos(e), sin(e), -cos(phi) * cos(e)])


def sunsky(mi, elevation: float, turbidity: float, azimuth: float, albedo: float = 0.3, **settings: float):
    """Mitsuba's emitter in our world: its +Z becomes +Y. The sun's direction is given in the world's axes."""
    return {
        "type": "sunsky",
        "sun_direction": towards_sun(elevation, azimuth).tolist(),
        "turbidity": turbidity,
        "albedo": {"type": "rgb", "value": albedo},
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90),
        **settings,
    }


def emitted(mi, description: dict, directions: np.ndarray) -> np.ndarray:
    """What an emitter sends from unit directions (N, 3) in the world: (N, 3)."""
    import drjit as dr

    hit = dr.zeros(mi.SurfaceInteraction3f)
    hit.wi = mi.Vector3f(*(np.ascontiguousarray(-axis, np.float32) for axis in directions.T))
    return np.array(mi.load_dict(description).eval(hit), dtype=float).T


def dome() -> tuple[np.ndarray, np.ndarray]:
    """Directions (N, 3) above the horizon and weights (N,) in sr: Gauss-Legendre in height, midpoints in azimuth."""
    y, weight = np.polynomial.legendre.leggauss(250)
    y, phi = np.repeat((y + 1) / 2, 500), np.tile((np.arange(500) + 0.5) * (2 * pi / 500), 250)
    r = np.sqrt(1 - y * y)
    return np.stack([r * np.cos(phi), y, r * np.sin(phi)], -1), np.repeat(weight / 2, 500) * (2 * pi / 500)


def sun_alone(mi, *sky: float) -> tuple[np.ndarray, np.ndarray]:
    """Directions (N, 3) on the disc and powers (N, 3), as the emitter samples itself for a rendering."""
    import drjit as dr

    n = 1 << 16
    points = mi.Point2f((np.arange(n) + 0.5) / n, np.modf(np.arange(n) * 0.6180339887498949)[0])
    found, power = mi.load_dict(sunsky(mi, *sky, sky_scale=0.0)).sample_direction(dr.zeros(mi.Interaction3f), points)
    return np.array(found.d, dtype=float).T, np.array(power, dtype=float).T.clip(0) / n


def irradiance_of_emitter(mi, normals: np.ndarray, *sky: float) -> np.ndarray:
    """(n, 3): quadrature of the dome, and the emitter's own samples of its sun."""
    directions, weights = dome()
    radiance = emitted(mi, sunsky(mi, *sky, sun_scale=0.0), directions).clip(0)
    discs, powers = sun_alone(mi, *sky)
    return ((normals @ directions.T).clip(0) * weights) @ radiance + (normals @ discs.T).clip(0) @ powers


def irradiance_of_probe(probe: tb.LightProbe, normals: np.ndarray) -> np.ndarray:
    """(n, 3): Gauss-Legendre with 4 x 4 points between any four texels."""
    height, width = probe.height, probe.width
    x, weight = np.polynomial.legendre.leggauss(4)
    x, weight = (x + 1) / 2, weight / 2
    theta = (np.arange(height - 1)[:, None] + x).ravel() * (pi / (height - 1))
    phi = (np.arange(width)[:, None] + 0.5 + x).ravel() * (2 * pi / width)
    by_theta = np.tile(weight, height - 1) * np.sin(theta) * (pi / (height - 1))
    by_phi = np.tile(weight, width) * (2 * pi / width)
    sin_theta = np.sin(theta)[:, None]
    up = np.broadcast_to(np.cos(theta)[:, None], (len(theta), len(phi)))
    directions = np.stack([np.sin(phi) * sin_theta, up, -np.cos(phi) * sin_theta], -1).reshape(-1, 3)
    radiance = probe.radiance_at(torch.from_numpy(directions)).double().numpy()
    return ((normals @ directions.T).clip(0) * np.outer(by_theta, by_phi).ravel()) @ radiance


@pytest.fixture(scope="module")
def normals() -> np.ndarray:
    return torch.nn.functional.normalize(torch.tensor(NORMALS, dtype=torch.float64), dim=-1).numpy()


@pytest.mark.parametrize(
    "sky", [(5.0, 3.0, 135.0), (30.0, 2.0, 40.0, 0.9), (70.0, 6.5, 300.0, 0.0), (1.0, 10.0, 0.0), (50.0, 1.0, -100.0)]
)
def test_irradiance_is_that_of_the_emitter(mi, normals, sky):
    """Per direction and per colour. (The sun spread over texels lights steep faces differently: hence the bound.)"""
    elevation, turbidity, azimuth, *albedo = sky
    albedo = {"ground_albedo": albedo[0]} if albedo else {}
    probe = tb.LightProbe.sky(elevation, turbidity, sun_azimuth=azimuth, height=128, **albedo)
    expected = irradiance_of_emitter(mi, normals, *sky)
    got = irradiance_of_probe(probe, normals)
    assert np.abs(got - expected).max() < 1e-3 * expected.max()
    np.testing.assert_allclose(got, expected, rtol=2e-3)
    mirrored = tb.LightProbe(probe.radiance.flip(-1))
    wrong = irradiance_of_probe(mirrored, normals)
    if sin(radians(azimuth)) != 0:
        assert np.abs(wrong - expected).max() > 0.05 * expected.max(), "the check sees a mirrored sky"


@pytest.mark.parametrize("height", [2, 17, 64])
def test_power_is_that_of_the_emitter_at_every_size(mi, height):
    """Texels are means: points would miss the glow around the sun, and the sun."""
    sky = (40.0, 8.0, 77.0)
    directions, weights = dome()
    power = weights @ emitted(mi, sunsky(mi, *sky, sun_scale=0.0), directions)
    disc = sun_alone(mi, *sky)[1].sum(0)
    probe = tb.LightProbe.sky(40, 8, sun_azimuth=77, height=height)
    np.testing.assert_allclose(probe.total_power.numpy(), power + disc, rtol=1e-3)
    alone = tb.LightProbe.sky(40, 8, sun_azimuth=77, height=height, sun=False)
    np.testing.assert_allclose((probe.total_power - alone.total_power).numpy(), disc, rtol=1e-3)


def test_a_rendering_is_that_of_mitsuba_under_sunsky(mi):
    """A white diffuse ball, lit by the emitter itself and by the probe: every pixel, so direction, colour and power."""
    view = tb.SphereView(12)
    sky = (25.0, 4.0, 100.0)
    probe = tb.LightProbe.sky(25, 4, sun_azimuth=100, height=256)

    def picture(lamp: dict, seed: int) -> np.ndarray:
        ball = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}}
        parts = {"integrator": {"type": "direct"}, "camera": sensor(mi, view), "ball": ball, "lamp": lamp}
        image = np.array(mi.render(mi.load_dict({"type": "scene", **parts}), spp=16384, seed=seed))
        return np.where(view.mask[0, :, :, None].numpy(), image, 0)

    truth = picture(sunsky(mi, *sky), 0)
    got = picture(light(mi, probe), 1)
    assert np.abs(got - truth).max() < 0.03 * truth.max(), "its noise is 1 %"
    np.testing.assert_allclose(got.mean((0, 1)), truth.mean((0, 1)), rtol=3e-3)
    other_side = picture(light(mi, tb.LightProbe.sky(25, 4, sun_azimuth=-100, height=256)), 1)
    assert np.abs(other_side - truth).max() > 0.5 * truth.max(), "the check sees a sun on the other side"


@pytest.mark.parametrize(
    ("azimuth", "towards"), [(0, [0, 0, -1]), (90, [1, 0, 0]), (180, [0, 0, 1]), (-90, [-1, 0, 0]), (450, [1, 0, 0])]
)
def test_where_the_sun_stands(mi, azimuth, towards):
    elevation = 20.0
    sky = tb.LightProbe.sky(elevation, 3, sun_azimuth=azimuth, height=64)
    without = tb.LightProbe.sky(elevation, 3, sun_azimuth=azimuth, height=64, sun=False)
    power = (sky.radiance - without.radiance)[1].double() * sky.solid_angles
    theta = torch.arange(64, dtype=torch.float64)[:, None] * (pi / 63)
    phi = (torch.arange(128, dtype=torch.float64) + 0.5) * (2 * pi / 128)
    moment = [torch.sin(phi) * torch.sin(theta), torch.cos(theta).expand(64, 128), -torch.cos(phi) * torch.sin(theta)]
    mean = torch.stack([(power * axis).sum() for axis in moment]) / power.sum()
    expected = cos(radians(elevation)) * np.array(towards, float) + [0, sin(radians(elevation)), 0]
    np.testing.assert_allclose(mean.numpy(), expected, atol=2e-3)
    assert int((power > 1e-6 * power.max()).sum()) <= 9, "the sun stays within the texels around it"


def test_rows_below_the_horizon_are_black_at_every_size(mi):
    assert not tb.LightProbe.sky(30, height=512, sun=False).radiance[:, 300:].any()


def test_default_sun_is_behind_the_camera_on_the_right(mi):
    probe = tb.LightProbe.sky(30, height=16)
    x, _, z = probe.sample(torch.rand(4096, 2, generator=torch.Generator().manual_seed(0)))[0].mean(0).tolist()
    assert x > 0.1
    assert z > 0.1


@pytest.mark.parametrize(
    ("elevation", "turbidity"), [(0, 1), (0, 10), (0.1, 2.5), (2, 10), (45, 4), (89.99, 1), (90, 10)]
)
def test_never_negative_and_never_black(mi, elevation, turbidity):
    """The emitter itself is black with its sun at 0 degrees, and negative in places with a low one."""
    probe = tb.LightProbe.sky(elevation, turbidity, height=32)
    assert probe.radiance.dtype == torch.float32
    assert bool(torch.isfinite(probe.radiance).all())
    assert float(probe.radiance.min()) >= 0
    assert float(probe.radiance[:, :16].amin(dim=(1, 2)).max()) > 0
    assert float(probe.radiance[:, 17:].max()) == 0, "the ground is black"
    assert float(probe.radiance[:, 0].std(dim=-1).max()) < 1e-6 * float(probe.radiance.max()), "a pole is one direction"


def test_half_the_disc_is_seen_at_the_horizon(mi):
    half, whole = (
        tb.LightProbe.sky(elevation, 3, height=64).total_power[0]
        - tb.LightProbe.sky(elevation, 3, height=64, sun=False).total_power[0]
        for elevation in (0, 1)
    )
    assert float(half / whole) == pytest.approx(0.5, abs=0.01)


def test_units(mi):
    """Illuminances of a clear day, as photographers know them: 80 to 105 klx from the sun at 60 degrees, and sky."""
    luminance = torch.tensor([0.2126, 0.7152, 0.0722], dtype=torch.float64)
    sky = tb.LightProbe.sky(60, 3, sun=False, height=64)
    both = tb.LightProbe.sky(60, 3, height=64)
    direct = float((both.total_power - sky.total_power) @ luminance) * CD_PER_UNIT
    assert 80e3 < direct < 105e3
    up = irradiance_of_probe(sky, np.array([[0.0, 1.0, 0.0]]))[0]
    assert 10e3 < float(torch.from_numpy(up) @ luminance) * CD_PER_UNIT < 30e3


def test_scalar_variant_gives_the_same(mi, monkeypatch):
    monkeypatch.setattr(sky_module, "_STEPS_PER_PI", 64)
    fast = tb.LightProbe.sky(12, 5, sun_azimuth=200, height=8).radiance
    before = mi.variant()
    try:
        load_mitsuba("scalar_rgb")
        slow = tb.LightProbe.sky(12, 5, sun_azimuth=200, height=8).radiance
    finally:
        mi.set_variant(before)
    torch.testing.assert_close(slow, fast, rtol=1e-5, atol=1e-7)


def test_turbidity_and_name(mi):
    clear, hazy = (tb.LightProbe.sky(30, t, height=16) for t in (1, 10))
    assert float(hazy.radiance.max()) < float(clear.radiance.max()), "haze takes from the sun"
    assert clear.name == "sky with the sun at 30 degrees, turbidity 1"
    assert tb.LightProbe.sky(30, height=16).fingerprint == tb.LightProbe.sky(30, 3.0, height=16).fingerprint


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sun_elevation": -1}, "sun_elevation must be from 0 (horizon) to 90 (zenith) degrees, got -1"),
        ({"sun_elevation": 90.5}, "sun_elevation must be from 0 (horizon) to 90 (zenith) degrees, got 90.5"),
        ({"sun_elevation": float("nan")}, "sun_elevation must be from 0 (horizon) to 90 (zenith) degrees, got nan"),
        ({"turbidity": 0.5}, "turbidity must be from 1 (clearest) to 10 (haze), got 0.5"),
        ({"turbidity": 11}, "turbidity must be from 1 (clearest) to 10 (haze), got 11"),
        ({"sun_azimuth": float("inf")}, "sun_azimuth must be a finite number of degrees, got inf"),
        ({"ground_albedo": 1.5}, "ground_albedo must be from 0 to 1, got 1.5"),
        ({"height": 1}, "height of a light probe must be at least 2, got 1"),
    ],
)
def test_bad_values(arguments, message):
    """Checked before Mitsuba is looked for."""
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        tb.LightProbe.sky(**{"sun_elevation": 30, **arguments})
