"""Light probes: conventions, exact integrals, importance sampling, rotation, layouts, bad input."""

import copy
import math
import re

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st
from scipy import stats
from scipy.spatial.transform import Rotation

from paths import ROOT
from probes import texel_directions
from torchbrdf.images import read_image, write_image
from torchbrdf.images.colour import luminance
from torchbrdf.light.latlong import area_mean, bilinear, directions_at, rotate, texel_coordinates
from torchbrdf.light.probe import LightProbe
from turns import turn_about

PROBES = ROOT.parent / "shared" / "data" / "probes"
needs_probes = pytest.mark.skipif(not PROBES.is_dir(), reason="../shared/data/probes is not there")
needs_cuda = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
DEVICES = ["cpu", pytest.param("cuda", marks=needs_cuda)]


def random_map(height: int = 9, seed: int = 0, sharp: float = 3.0) -> torch.Tensor:
    """Radiance over a few decades, with one texel in five black."""
    g = torch.Generator().manual_seed(seed)
    radiance = torch.exp(sharp * torch.randn(3, height, 2 * height, generator=g))
    return radiance * (torch.rand(height, 2 * height, generator=g) > 0.2)


def random_directions(n: int, seed: int = 0) -> torch.Tensor:
    g = torch.Generator().manual_seed(seed)
    return torch.nn.functional.normalize(torch.randn(n, 3, generator=g, dtype=torch.float64), dim=-1).float()


def patch_quadrature(height: int, steps: int, cells: int = 1) -> tuple[torch.Tensor, torch.Tensor]:
    """Directions and weights in sr for integrals over the sphere: Gauss-Legendre in each of `cells` x `cells`
    parts of each patch between four texels.
    """
    nodes, weights = (torch.from_numpy(a) for a in np.polynomial.legendre.leggauss(steps))
    inside = ((torch.arange(cells)[:, None] + (nodes + 1) / 2) / cells).reshape(-1)
    weights = weights.repeat(cells) / cells
    y = (torch.arange(height - 1)[:, None] + inside).reshape(-1)
    x = (torch.arange(2 * height)[:, None] + inside).reshape(-1)
    by_row, by_column = weights.repeat(height - 1) / 2, weights.repeat(2 * height) / 2
    sine = torch.sin(y * math.pi / (height - 1))
    area = (math.pi / (height - 1)) * (math.pi / height)
    y, x = torch.meshgrid(y, x, indexing="ij")
    return directions_at(x, y, height, 2 * height), (by_row * sine)[:, None] * by_column * area


def rotation_matrix(seed: int) -> torch.Tensor:
    return torch.from_numpy(Rotation.random(random_state=seed).as_matrix())


# --- Convention and lookup -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("direction", "x", "y"),
    [
        ((0.0, 1.0, 0.0), None, 0),  # +Y: first row
        ((0.0, -1.0, 0.0), None, 8),  # -Y: last row
        ((1.0, 0.0, 0.0), 3.5, 4),  # +X: a quarter of the width of 16, whose texels are centred
        ((0.0, 0.0, 1.0), 7.5, 4),  # +Z: the middle of the map
        ((-1.0, 0.0, 0.0), 11.5, 4),
        ((0.0, 0.0, -1.0), -0.5, 4),  # -Z, forward: the seam
    ],
)
def test_where_the_axes_are(direction, x, y):
    at_x, at_y, _ = texel_coordinates(torch.tensor(direction), 9, 18 - 2)
    assert x is None or float(at_x) == pytest.approx(x, abs=1e-5)
    assert float(at_y) == pytest.approx(y, abs=1e-5)


def test_a_texel_is_seen_in_its_direction():
    probe = LightProbe(random_map(6, sharp=0.5))
    phi, theta = 2 * math.pi * (4 + 0.5) / 12, math.pi * 2 / 5
    d = [math.sin(phi) * math.sin(theta), math.cos(theta), -math.cos(phi) * math.sin(theta)]
    torch.testing.assert_close(probe.radiance_at(torch.tensor(d)), probe.radiance[:, 2, 4], rtol=0, atol=1e-5)
    everywhere = probe.radiance_at(texel_directions(6)).permute(2, 0, 1)
    torch.testing.assert_close(everywhere[:, 1:-1], probe.radiance[:, 1:-1], rtol=0, atol=1e-5)


def test_the_seam_is_halfway_between_last_and_first_column():
    probe = LightProbe(random_map(5))
    forward = probe.radiance_at(torch.tensor([0.0, 0.0, -1.0]))
    torch.testing.assert_close(forward, (probe.radiance[:, 2, 0] + probe.radiance[:, 2, -1]) / 2)


@given(st.integers(2, 12), st.integers(0, 1000))
@settings(deadline=None, max_examples=30)
def test_lookup_is_bilinear(height, seed):
    radiance = random_map(height, seed, sharp=0.5) + 0.1
    directions = random_directions(64, seed)
    found = LightProbe(radiance).radiance_at(directions.reshape(8, 8, 3)).reshape(64, 3)
    d, texels = directions.double().numpy(), radiance.double().numpy()
    x = (np.arctan2(d[:, 0], -d[:, 2]) / (2 * np.pi)) % 1 * 2 * height - 0.5
    y = np.arccos(d[:, 1]) / np.pi * (height - 1)
    x0, y0 = np.floor(x).astype(int), np.minimum(np.floor(y).astype(int), height - 2)
    s, t = x - x0, y - y0
    expected = sum(
        weight * texels[:, y0 + j, (x0 + i) % (2 * height)]
        for i, column_share in enumerate((1 - s, s))
        for j, weight in enumerate((column_share * (1 - t), column_share * t))
    )
    np.testing.assert_allclose(found.numpy(), expected.T, rtol=2e-5, atol=2e-5)


def test_gradient_reaches_the_given_radiance():
    radiance = random_map(5).abs().add(0.1).double().requires_grad_()
    directions = random_directions(40_000)  # more than one chunk
    probe = LightProbe(radiance)
    probe.radiance_at(directions).sum().backward()
    # The lookup is linear in the radiance: the gradient contracted with it is the value itself.
    gradient = radiance.grad
    assert gradient is not None
    value = float(probe.radiance_at(directions).detach().sum())
    assert float((gradient * radiance).detach().sum()) == pytest.approx(value, rel=1e-4)
    assert float(gradient.sum()) == pytest.approx(3 * 40_000, rel=1e-5)
    assert (gradient > 0).all()


# --- Solid angles ----------------------------------------------------------------------------------------


@given(st.integers(2, 700))
@settings(deadline=None, max_examples=40)
def test_solid_angles_sum_to_the_sphere(height):
    probe = LightProbe(torch.ones(3, height, 2 * height))
    assert probe.solid_angles.shape == (height, 2 * height)
    assert probe.solid_angles.dtype == torch.float64
    assert float(probe.solid_angles.sum()) == pytest.approx(4 * math.pi, rel=1e-12)
    assert (probe.solid_angles > 0).all()


def test_solid_angles_integrate_the_bilinear_radiance_exactly():
    probe = LightProbe(random_map(9))
    directions, weights = patch_quadrature(9, 8)
    brute = (probe.radiance_at(directions) * weights[..., None]).sum(dim=(0, 1))
    torch.testing.assert_close(probe.total_power, brute.double(), rtol=2e-6, atol=0)
    torch.testing.assert_close(probe.mean_radiance, brute.double() / (4 * math.pi), rtol=2e-6, atol=0)
    one_hot = torch.zeros(3, 9, 18)
    one_hot[:, 0, 3] = 1  # a pole's texel
    brute = (LightProbe(one_hot).radiance_at(directions) * weights[..., None]).sum(dim=(0, 1))
    assert float(brute[0]) == pytest.approx(float(probe.solid_angles[0, 3]), rel=1e-5)


# --- Importance sampling ---------------------------------------------------------------------------------


def samplers() -> list[LightProbe]:
    single = torch.zeros(3, 8, 16)
    single[:, 5, 15] = 7.0  # its patches straddle the seam
    pole = torch.zeros(3, 8, 16)
    pole[1, 0, 2] = 1.0
    return [
        LightProbe(random_map(9)),
        LightProbe(random_map(2, seed=3)),
        LightProbe(single, name="single"),
        LightProbe(pole, name="pole"),
        LightProbe.default(32),
    ]


@pytest.mark.parametrize("probe", samplers(), ids=repr)
def test_density_integrates_to_one(probe):
    directions, weights = patch_quadrature(probe.height, 16)
    assert float((probe.pdf(directions).double() * weights).sum()) == pytest.approx(1, abs=2e-5)


@pytest.mark.parametrize("probe", samplers(), ids=repr)
def test_samples_follow_the_density(probe):
    """Chi-square over a grid three times finer than the texels, in both directions."""
    n = 200_000
    u = torch.rand(n, 2, generator=torch.Generator().manual_seed(5))
    directions, pdf = probe.sample(u)
    assert directions.dtype == pdf.dtype == torch.float32
    torch.testing.assert_close(directions.norm(dim=-1), torch.ones(n), rtol=0, atol=1e-6)
    assert (pdf > 0).all()

    rows, columns = 3 * (probe.height - 1), 6 * probe.height
    x, y, _ = texel_coordinates(directions.double(), probe.height, probe.width)
    row = (y * 3).long().clamp(0, rows - 1)
    column = (x * 3).floor().long() % columns
    counts = torch.bincount(row * columns + column, minlength=rows * columns).double()

    quadrature, weights = patch_quadrature(probe.height, 8, cells=3)
    x, y, _ = texel_coordinates(quadrature, probe.height, probe.width)
    cell = (y * 3).long().clamp(0, rows - 1) * columns + (x * 3).floor().long() % columns
    expected = torch.zeros(rows * columns, dtype=torch.float64)
    expected.index_add_(0, cell.reshape(-1), (probe.pdf(quadrature).double() * weights).reshape(-1))
    expected *= n
    assert counts[expected == 0].sum() == 0
    few = expected < 8
    pooled_counts = torch.cat([counts[~few], counts[few].sum()[None]])
    pooled = torch.cat([expected[~few], expected[few].sum()[None] + 1e-9])
    statistic = float(((pooled_counts - pooled) ** 2 / pooled.clamp_min(1))[pooled > 1].sum())
    assert stats.chi2.sf(statistic, int((pooled > 1).sum()) - 1) > 1e-4


@pytest.mark.parametrize("probe", samplers(), ids=repr)
def test_sample_and_pdf_agree_and_the_estimator_is_unbiased(probe):
    n = 100_000
    directions, pdf = probe.sample(torch.rand(n, 2, generator=torch.Generator().manual_seed(6)))
    again = probe.pdf(directions)
    assert float(((again - pdf).abs() / pdf).quantile(0.999)) < 2e-3
    estimates = luminance(probe.radiance_at(directions).T).double() / pdf
    mean, spread = estimates.mean(), estimates.std()
    exact = luminance(probe.total_power)
    assert float((mean - exact).abs()) < 4.5 * float(spread) / math.sqrt(n) + 1e-5 * float(exact)
    # Near-perfect sampling: only the poles' rows and the curvature of sin theta within a patch remain.
    assert float(estimates.max()) < 3.1 * float(exact)


def test_default_probe_is_sampled_almost_perfectly():
    probe = LightProbe.default()
    directions, pdf = probe.sample(torch.rand(50_000, 2, generator=torch.Generator().manual_seed(1)))
    ratio = luminance(probe.radiance_at(directions).T) / pdf
    assert float(ratio.std() / ratio.mean()) < 0.02


def test_black_texels_are_never_met():
    radiance = torch.zeros(3, 16, 32)
    radiance[2, 4, 7:9] = 1e-3
    radiance[0, 11, 31] = 1e4
    probe = LightProbe(radiance)
    edge = torch.tensor([0.0, 1e-12, 0.25, 0.5, 1 - 2.0**-24, 1.0], dtype=torch.float64)
    u = torch.cat([torch.cartesian_prod(edge, edge), torch.rand(100_000, 2, dtype=torch.float64)])
    for points in (u, u.float()):
        directions, pdf = probe.sample(points)
        seen = probe.radiance_at(directions).sum(dim=-1)
        assert torch.isfinite(directions).all()
        assert ((pdf > 0) & torch.isfinite(pdf)).all()
        # 1e-4 of the range: a direction in float32 on the rim of a patch may fall just outside it.
        assert float((seen <= 0).double().mean()) < 1e-4
    assert probe.pdf(torch.tensor([0.0, 0.0, 1.0])) == 0


def test_sampling_is_deterministic_and_keeps_shapes():
    probe = LightProbe.default(16)
    u = torch.rand(3, 1, 5, 2)
    directions, pdf = probe.sample(u)
    assert directions.shape == (3, 1, 5, 3)
    assert pdf.shape == (3, 1, 5)
    assert torch.equal(probe.sample(u)[0], directions)
    assert torch.equal(probe.sample(u[1, 0, 2])[0], directions[1, 0, 2])
    assert probe.pdf(directions).shape == (3, 1, 5)
    empty, none = probe.sample(torch.rand(0, 2))
    assert empty.shape == (0, 3)
    assert none.shape == probe.pdf(empty).shape == (0,)
    assert probe.radiance_at(empty).shape == (0, 3)


# --- Rotation, scale, size -------------------------------------------------------------------------------


def test_rotation_moves_light_from_d_to_R_d():
    radiance = torch.zeros(3, 64, 128)
    radiance[:, 20, 37] = 1
    d = directions_at(torch.tensor(37), torch.tensor(20), 64, 128)
    for seed in range(5):
        rotation = rotation_matrix(seed).float()
        turned = LightProbe(radiance).rotated(rotation)
        seen = (turned.radiance.double() * turned.solid_angles)[0]
        mean = (seen[..., None] * texel_directions(64)).sum(dim=(0, 1))
        centre = torch.nn.functional.normalize(mean, dim=0)
        assert float(torch.linalg.vector_norm(centre - rotation @ d)) < 0.01  # a texel is 0.05


def test_rotation_of_a_smooth_probe_is_accurate():
    def smooth(d: torch.Tensor) -> torch.Tensor:
        return torch.stack([2 + d[..., 0], 2 + d[..., 1] * d[..., 2], 1 + d[..., 2] ** 2])

    d = texel_directions(64)
    rotation = rotation_matrix(11)
    turned = LightProbe(smooth(d)).rotated(rotation)
    expected = smooth(d @ rotation.float())  # (R^T d) as a row
    error = (turned.radiance - expected).abs().amax((0, 2))
    assert float(error[[1, -2]].max()) < 7e-3  # their footprints keep the power of lamps there, off their centres
    error[[1, -2]] = 0
    assert float(error.max()) < 4e-3


def test_a_lamp_turned_to_a_pole_keeps_its_power():
    radiance = torch.zeros(3, 64, 128)
    radiance[:, 30, 50] = 1000
    probe = LightProbe(radiance)
    lamp = texel_directions(64)[30, 50].double()
    for degrees in (0, 0.7, 1.4, 2.5, 4):  # a row is 2.86
        aim = torch.tensor([math.sin(math.radians(degrees)), math.cos(math.radians(degrees)), 0], dtype=torch.float64)
        rotation = turn_about(torch.linalg.cross(lamp, aim).tolist(), math.degrees(math.acos(lamp @ aim)))
        torch.testing.assert_close(rotation @ lamp, aim, rtol=0, atol=1e-6)
        change = probe.rotated(rotation).total_power / probe.total_power - 1
        assert float(change.abs().max()) < 0.01, degrees  # texels as means of boxes: 0.17


@pytest.mark.parametrize("row", [0, 1, 2, 3, 200, 254])
def test_resizing_keeps_the_power_of_a_lamp_at_a_pole(row):
    radiance = torch.zeros(3, 256, 512)
    radiance[:, row] = 1000
    probe = LightProbe(radiance)
    for height in (32, 64, 96):
        change = probe.resized(height).total_power / probe.total_power - 1
        assert float(change.abs().max()) < 2e-3, height  # texels as means of boxes: 0.38


@given(st.integers(-40, 40), st.integers(2, 16))
@settings(deadline=None, max_examples=40)
def test_rotation_about_up_by_whole_texels_is_a_roll(columns, height):
    probe = LightProbe(random_map(height) + 0.01)
    angle = columns * math.pi / height
    for dtype in (torch.float64, torch.float32):
        rotation = torch.from_numpy(Rotation.from_euler("y", angle).as_matrix()).to(dtype)
        turned = probe.rotated(rotation)
        # phi grows from -Z to +X, against a positive turn about +Y.
        assert torch.equal(turned.radiance, torch.roll(probe.radiance, -columns, dims=2))


def test_half_a_texel_about_up_is_the_mean_of_neighbours():
    probe = LightProbe(random_map(8, sharp=0.5)[:, 3:4].expand(3, 8, 16))  # the same in every row
    turned = probe.rotated(torch.from_numpy(Rotation.from_euler("y", -0.5 * math.pi / 8).as_matrix()))
    # A footprint then reaches from texel to texel, and radiance is linear between them.
    mean = (probe.radiance + torch.roll(probe.radiance, 1, dims=2)) / 2
    torch.testing.assert_close(turned.radiance[:, 1:-1], mean[:, 1:-1], rtol=0, atol=1e-4)


def energy_error(probe: LightProbe, n: int = 4) -> float:
    turned = [probe.rotated(rotation_matrix(seed)) for seed in range(n)]
    return max(float((t.total_power / probe.total_power - 1).abs().max()) for t in turned)


def test_rotation_keeps_the_energy():
    assert energy_error(LightProbe.default()) < 2e-4  # measured: 6e-5


@needs_probes
@pytest.mark.parametrize(("name", "limit"), [("ennis", 1e-4), ("grace", 7e-3)])  # measured: 2.4e-5, 4.8e-3
def test_rotation_keeps_the_energy_of_real_probes(name, limit):
    assert energy_error(LightProbe.open(PROBES / f"{name}.hdr")) < limit


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (torch.eye(4), r"^rotation must be \(3, 3\), got \(4, 4\)$"),
        (torch.diag(torch.tensor([1.0, 1.0, -1.0])), r"determinant [+]1, got determinant -1 and"),
        (2 * torch.eye(3), r"determinant [+]1, got determinant 8 and \|R R\^T - 1\| up to 3$"),
        (torch.full((3, 3), math.nan), r"determinant [+]1, got determinant nan"),
    ],
)
def test_bad_rotations(matrix, message):
    with pytest.raises(ValueError, match=message):
        LightProbe.default(8).rotated(matrix)


def test_scaling():
    probe = LightProbe.default(8)
    assert torch.equal(probe.scaled(2.5).radiance, probe.radiance * 2.5)
    for factor in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match=f"^scale of a light probe must be positive.*, got {factor}$"):
            probe.scaled(factor)


@pytest.mark.parametrize("height", [8, 31, 64, 100, 200])
def test_resizing_keeps_energy_and_constants(height):
    probe = LightProbe.default(64)
    resized = probe.resized(height)
    assert resized.radiance.shape == (3, height, 2 * height)
    limit = 6e-4 if height == 8 else 1.5e-4
    torch.testing.assert_close(resized.total_power, probe.total_power, rtol=limit, atol=0)
    flat = LightProbe(torch.full((3, 64, 128), 3.0)).resized(height)
    torch.testing.assert_close(flat.radiance, torch.full_like(flat.radiance, 3.0))
    # The centre of the light stays where it was, within a fifth of a texel of the smaller map.
    towards = [
        (p.radiance[0, ..., None] * p.solid_angles[..., None] * texel_directions(p.height)).sum((0, 1))
        for p in (probe, resized)
    ]
    a, b = (torch.nn.functional.normalize(v, dim=0) for v in towards)
    assert float((a - b).norm()) < 0.2 * math.pi / min(height, 64)


def test_resizing_to_the_same_height_is_the_same_probe():
    probe = LightProbe.default(16)
    assert probe.resized(16) is probe
    with pytest.raises(ValueError, match=r"^height of a light probe must be at least 2, got 1$"):
        probe.resized(1)


# --- The default probe, identity, devices ----------------------------------------------------------------


@pytest.mark.parametrize("height", [64, 128])
def test_default_probe_is_rich(height):
    probe = LightProbe.default(height)
    bright = luminance(probe.radiance)
    assert float(bright.max() / bright.min()) > 1e5
    assert torch.equal(probe.radiance, LightProbe.default(height).radiance)
    # Light from all sides: each of the eight octants has at least 1 % of the energy.
    energy = bright.double() * probe.solid_angles
    d = texel_directions(height)
    for signs in torch.cartesian_prod(*[torch.tensor([-1.0, 1.0])] * 3):
        octant = ((d * signs) >= 0).all(dim=-1)
        assert float(energy[octant].sum() / energy.sum()) > 0.01, signs
    # No single source rules: the brightest 0.2 % of the sphere holds less than 60 % of the energy.
    order = bright.reshape(-1).argsort(descending=True)
    covered = probe.solid_angles.reshape(-1)[order].cumsum(0) < 0.002 * 4 * math.pi
    assert float(energy.reshape(-1)[order][covered].sum() / energy.sum()) < 0.6


def test_default_probe_is_the_same_light_at_every_height():
    powers = torch.stack([LightProbe.default(h).total_power for h in (32, 128, 200)])
    torch.testing.assert_close(powers, powers[1].expand(3, 3), rtol=0.01, atol=0)


def test_fingerprint_and_repr():
    probe = LightProbe(torch.ones(3, 4, 8) * torch.tensor([1.0, 2.0, 3.0])[:, None, None], name="flat")
    assert probe.fingerprint == LightProbe(probe.radiance.double()).fingerprint
    assert len(probe.fingerprint) == 64
    assert probe.fingerprint != probe.scaled(1.0001).fingerprint
    assert repr(probe) == "LightProbe('flat', 4 x 8, luminance 1.86 to 1.86, mean 1.86)"


def test_the_probe_keeps_its_own_copy_and_can_be_copied():
    given_map = torch.ones(3, 4, 8)
    probe = LightProbe(given_map)
    array = np.ones((3, 4, 8))
    of_array = LightProbe(array)
    given_map[:] = 5
    array[:] = 5
    assert (probe.radiance == 1).all()
    assert (of_array.radiance == 1).all()
    assert of_array.radiance.dtype == torch.float32
    assert copy.deepcopy(probe).fingerprint == probe.fingerprint
    with pytest.raises(AttributeError):
        probe.radiance = given_map


@pytest.mark.parametrize("device", DEVICES)
def test_devices(device):
    here = LightProbe.default(32)
    probe = here.to(device)
    assert probe.device.type == device
    assert probe.fingerprint == here.fingerprint
    u = torch.rand(1000, 2, dtype=torch.float64)
    directions, pdf = probe.sample(u.to(device))
    expected, expected_pdf = here.sample(u)
    torch.testing.assert_close(directions.cpu(), expected, rtol=0, atol=1e-5)
    torch.testing.assert_close(pdf.cpu(), expected_pdf, rtol=1e-3, atol=1e-6)
    d = random_directions(500)
    seen, expected = probe.radiance_at(d.to(device)).cpu(), here.radiance_at(d)
    torch.testing.assert_close(seen, expected, rtol=1e-3, atol=1e-2)
    torch.testing.assert_close(probe.pdf(d.to(device)).cpu(), here.pdf(d), rtol=1e-3, atol=1e-3)
    for made in (probe.rotated(rotation_matrix(0)), probe.resized(16), probe.scaled(2.0)):
        assert made.device.type == device
        assert made.solid_angles.device.type == device


# --- Layouts ---------------------------------------------------------------------------------------------


def scene(d: torch.Tensor) -> torch.Tensor:
    """A smooth asymmetric radiance (3, ...) of directions (..., 3)."""
    x, y, z = d.unbind(-1)
    return torch.stack([1.5 + x + 0.3 * y * z, 1.5 + y + 0.3 * x * z, 1.5 + z + 0.3 * x * y])


def square(size: int) -> tuple[torch.Tensor, torch.Tensor]:
    at = (torch.arange(size) + 0.5) / size * 2 - 1
    v, u = torch.meshgrid(-at, at, indexing="ij")
    return u, v


def angular_map(size: int) -> torch.Tensor:
    u, v = square(size)
    r = torch.hypot(u, v)
    sine = torch.sin(math.pi * r) / r
    d = torch.stack([u * sine, v * sine, -torch.cos(math.pi * r)], dim=-1)
    return torch.where(r <= 1, scene(d), 777.0)  # nonsense outside the disc must not be seen


def mirror_ball(size: int) -> torch.Tensor:
    u, v = square(size)
    n = torch.stack([u, v, (1 - u * u - v * v).clamp_min(0).sqrt()], dim=-1)
    reflected = 2 * n[..., 2:] * n - torch.tensor([0.0, 0.0, 1.0])
    return torch.where(torch.hypot(u, v) <= 1 - 1 / size, scene(reflected), math.nan)


@pytest.mark.parametrize(
    ("layout", "picture", "worst", "mean"),
    # The rim of a mirror ball shows all of the surroundings of -Z in less than a pixel.
    [("angular", angular_map, 0.01, 5e-4), ("mirror_ball", mirror_ball, 0.35, 4e-3)],
)
def test_layouts_of_a_known_scene(tmp_path, layout, picture, worst, mean):
    path = tmp_path / "probe.exr"
    write_image(path, picture(128))
    probe = LightProbe.open(path, layout=layout, height=64)
    assert probe.radiance.shape == (3, 64, 128)
    expected = scene(texel_directions(64))
    error = (probe.radiance - expected).abs()
    assert float(error.max()) < worst
    weighted = float((error * probe.solid_angles).sum() / (expected * probe.solid_angles).sum())
    assert weighted < mean
    assert LightProbe.open(path, layout=layout, height=20).radiance.shape == (3, 20, 40)


@needs_probes
@pytest.mark.filterwarnings("ignore:light probe:UserWarning")
def test_angular_map_of_uffizi_against_another_program():
    """That program's lat-long is mirrored, with -Z in the middle, and texel-centred in both axes.

    Residual: 2.7 % RMS texel by texel (it looks up points, we take means), 1.0 % over 4 x 4 texels.
    """
    probe = LightProbe.open(PROBES / "uffizi_angularmap.exr", layout="angular", height=128)
    theirs = read_image(PROBES / "uffizi_angularmap_as_latlong.exr").clamp_min(0)
    _, height, width = theirs.shape
    theta = (torch.arange(height)[:, None] + 0.5) * math.pi / height
    weight = torch.sin(theta).expand(height, width)

    def residual(phi: torch.Tensor, block: int) -> float:
        sine = torch.sin(theta)
        up = torch.cos(theta).expand(height, width)
        ours = probe.radiance_at(torch.stack([torch.sin(phi) * sine, up, -torch.cos(phi) * sine], dim=-1))
        ours = ours.permute(2, 0, 1)
        a, b, w = (torch.nn.functional.avg_pool2d(m, block) for m in (ours, theirs, weight[None]))
        return math.sqrt(float((w * (a - b) ** 2).sum() / (w * b * b).sum()))

    azimuth = (torch.arange(width) + 0.5) * 2 * math.pi / width
    assert residual(math.pi - azimuth, 1) < 0.03
    assert residual(math.pi - azimuth, 4) < 0.012
    # The ruler can tell: every other handedness or quarter turn is far off.
    for turn in range(4):
        assert residual(azimuth + turn * math.pi / 2, 1) > 0.15
        if turn != 2:
            assert residual(-azimuth + turn * math.pi / 2, 1) > 0.15


@needs_probes
@pytest.mark.filterwarnings("ignore:light probe:UserWarning")
def test_angular_map_of_uffizi_has_the_handedness_of_the_published_latlong():
    """Against `uffizi.hdr`: no mirroring, a turn of a quarter about +Y; residual 8.7 % RMS at 64 rows."""
    ours = LightProbe.open(PROBES / "uffizi_angularmap.exr", layout="angular", height=64)
    published = LightProbe.open(PROBES / "uffizi.hdr", height=64)
    turned = ours.rotated(torch.from_numpy(Rotation.from_euler("y", math.pi / 2).as_matrix())).radiance
    weight = published.solid_angles
    norm = float((weight * published.radiance**2).sum())
    assert math.sqrt(float((weight * (turned - published.radiance) ** 2).sum()) / norm) < 0.1
    assert math.sqrt(float((weight * (turned.flip(2) - published.radiance) ** 2).sum()) / norm) > 0.15


# --- Bad input -------------------------------------------------------------------------------------------


def test_repair_fills_from_neighbours_across_the_seam():
    radiance = torch.zeros(3, 6, 12)
    radiance[:, :, :] = torch.arange(12.0)
    radiance[:, 2, 0] = math.nan
    radiance[1, 4, 6] = -math.inf
    share = 100 * float(LightProbe(torch.ones(3, 6, 12)).solid_angles[[2, 4], [0, 6]].sum()) / (4 * math.pi)
    what = f"light probe has 1 NaN texel and 1 -infinite texel of 72 ({share:.2g} % of the sphere; in 2 places, "
    what += "the largest at row 2, column 0, counted from 0); "
    message = what + "give --repair-probe (repair=True in Python) to fill them from their neighbours"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        LightProbe(radiance)
    with pytest.warns(UserWarning, match=f"^{re.escape(what)}filled from their neighbours$"):
        fixed = LightProbe(radiance, repair=True).radiance
    assert fixed[:, 2, 0].tolist() == pytest.approx([(3 * 11 + 3 * 1 + 2 * 0) / 8] * 3)
    assert fixed[:, 4, 6].tolist() == pytest.approx([6.0] * 3)
    untouched = torch.isfinite(radiance).all(dim=0)
    assert torch.equal(fixed[:, untouched], radiance[:, untouched])


def test_repair_closes_large_holes_and_changes_nothing_else():
    radiance = torch.full((3, 40, 80), 2.5)
    radiance[:, 5:35, 60:] = math.nan
    radiance[:, 5:35, :20] = -math.inf
    with pytest.warns(UserWarning, match="600 NaN texels and 600 -infinite texels of 3200"):
        assert LightProbe(radiance, repair=True).radiance.unique().tolist() == [2.5]


@pytest.mark.parametrize("repair", [False, True])
def test_infinite_texels_are_never_filled(repair):
    """Not even beside a hole: nothing around a clipped lamp says how bright it is."""
    radiance = torch.ones(3, 6, 12)
    radiance[0, 2:4, 5] = math.inf
    radiance[:, 2, 4] = math.nan
    message = "light probe has 2 infinite texels of 72 (rows 2 to 3, column 5, counted from 0): a lamp too"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}") as caught:
        LightProbe(radiance, repair=repair)
    assert "repair" not in str(caught.value)


@pytest.mark.parametrize("repair", [False, True])
def test_texels_that_no_light_has_are_refused(repair):
    """Their sums, and what is made of them by resampling, would be infinite."""
    radiance = torch.ones(3, 6, 12)
    radiance[1, 2, 5] = 3e38
    with pytest.raises(ValueError, match=r"has 1 texel of 72 beyond 1e\+30 \(row 2, column 5, counted from 0\)"):
        LightProbe(radiance, repair=repair)


def test_the_largest_half_float_is_a_clipped_lamp():
    radiance = torch.ones(3, 6, 12)
    radiance[1, 2, 3] = 65503
    assert LightProbe(radiance).radiance.max() == 65503
    radiance[1, 2, 3] = 65504
    message = r"^light probe has 1 texel of exactly 65504, the largest half float \(row 2, column 3, counted from 0\)"
    with pytest.warns(UserWarning, match=message) as caught:
        assert LightProbe(radiance).radiance.max() == 65504
    assert [warning.filename for warning in caught] == [__file__]


def test_negative_values_are_clamped_with_a_warning():
    radiance = torch.ones(3, 4, 8)
    radiance[0, 1, 2] = -0.5
    radiance[2, 1, 2] = -0.25
    radiance[2, 2, 0] = -0.125
    # Inside rows of 4 have equal areas a; the poles' sum to 4 pi - 16 a.
    area = float(LightProbe(radiance.abs()).solid_angles[1, 0])
    share = 100 * 0.875 * area / (3 * 4 * math.pi - (0.5 + 0.75 + 0.875) * area)
    message = "light probe has 3 negative values in 2 texels of 32 "
    message += f"({share:.2g} % of the energy, lowest -0.5); set to 0"
    with pytest.warns(UserWarning, match=f"^{re.escape(message)}$") as caught:
        probe = LightProbe(radiance)
    assert caught[0].filename == __file__
    assert torch.equal(probe.radiance, radiance.clamp_min(0))


@pytest.mark.parametrize(
    ("radiance", "message"),
    [
        (
            torch.ones(3, 64, 64),
            "light probe must be lat-long (width = 2 x height), got 64 x 64; it looks like a mirror ball or an angular "
            "map: give --probe-layout mirror_ball or --probe-layout angular "
            "(layout= and circle= of tb.LightProbe.open in Python)",
        ),
        (
            torch.ones(3, 1, 2),
            "light probe must be lat-long (width = 2 x height), got 1 x 2; "
            "crop or convert it; for a photograph of a mirror ball give --probe-layout mirror_ball with "
            "--probe-circle X Y R (layout= and circle= of tb.LightProbe.open in Python)",
        ),
        (torch.ones(4, 8, 3), "light probe must be (3, H, W) linear RGB, got (4, 8, 3); permute it: movedim(-1, 0)"),
        (torch.ones(1, 3, 4, 8), "light probe must be (3, H, W) linear RGB, got (1, 3, 4, 8)"),
        (
            torch.ones(3, 4, 8, dtype=torch.uint8),
            "light probe must hold linear floating-point radiance, got torch.uint8",
        ),
        (
            torch.zeros(3, 4, 8),
            "light probe has no energy: every texel is 0; give a probe that emits light",
        ),
        (
            torch.full((3, 4, 8), math.nan),
            "light probe has no valid texel: all 32 hold NaN or infinite values",
        ),
    ],
)
def test_bad_maps(radiance, message):
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        LightProbe(radiance)


def test_bad_files(tmp_path):
    path = tmp_path / "p.exr"
    with pytest.raises(FileNotFoundError, match=r"p\.exr: no such file; expected an image \(\.exr\)$"):
        LightProbe.open(path)
    write_image(path, torch.ones(3, 6, 9))
    message = f"light probe {path} must be lat-long (width = 2 x height), got 6 x 9; crop or"
    with pytest.raises(ValueError, match=re.escape(message)):
        LightProbe.open(path)
    message = f"light probe {path}, a picture of layout angular, must be square, got 6 x 9; crop it to the disc, or"
    with pytest.raises(ValueError, match=re.escape(message)):
        LightProbe.open(path, layout="angular")
    with pytest.raises(ValueError, match=r"be one of latlong, angular, .*, envmap_cube, got 'cube'$"):
        LightProbe.open(path, layout="cube")


def test_bad_shapes_of_directions_and_points():
    probe = LightProbe.default(8)
    with pytest.raises(ValueError, match=r"^directions must be \(\.\.\., 3\), got \(3, 5\)$"):
        probe.radiance_at(torch.ones(3, 5))
    with pytest.raises(ValueError, match=r"^directions must be \(\.\.\., 3\), got \(\)$"):
        probe.pdf(torch.tensor(1.0))
    with pytest.raises(ValueError, match=r"^u must be \(\.\.\., 2\), got \(7,\)$"):
        probe.sample(torch.ones(7))


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_directions_and_points_that_are_not_finite(value: float):
    probe = LightProbe.default(8)
    directions = torch.tensor([[0.0, 0.0, 1.0], [value, 0.0, 1.0]])
    for asked in (probe.radiance_at, probe.pdf):
        with pytest.raises(ValueError, match=r"^directions must be finite, got NaN or infinity in \(2, 3\); leave"):
            asked(directions)
    with pytest.raises(ValueError, match=r"^u must be finite, got "):
        probe.sample(directions[:, :2])


@needs_probes
@pytest.mark.filterwarnings("ignore:light probe:UserWarning")
def test_a_probe_file_with_invalid_texels():
    path = PROBES / "bad_nan_inf.exr"
    message = r"bad_nan_inf\.exr has \d+ infinite texels? of 524288 \("
    for repair in (False, True):
        with pytest.raises(ValueError, match=message):
            LightProbe.open(path, repair=repair)
    stored = read_image(path)
    holes = torch.where(stored == math.inf, math.nan, stored)
    valid = torch.isfinite(stored).all(dim=0)
    repaired = LightProbe(holes, repair=True).radiance
    assert torch.isfinite(repaired).all()
    assert torch.equal(repaired[:, valid], stored[:, valid].clamp_min(0))


def test_rotated_texels_are_means_of_bilinear_lookups_over_their_footprints():
    radiance = torch.rand(3, 9, 18, generator=torch.Generator().manual_seed(5))
    rotation = rotation_matrix(7)
    turned = rotate(radiance, rotation, supersampling=3)
    expected = area_mean(lambda d: bilinear(radiance.double(), d.double() @ rotation), 9, 18, 3)
    torch.testing.assert_close(turned, expected.float(), rtol=1e-5, atol=1e-5)


def test_saved_in_a_colour_space_that_is_none(tmp_path):
    with pytest.raises(ValueError, match=r"^primaries must be one of rec709, .*, got 'srgb'$"):
        LightProbe.default(8).save(tmp_path / "a.exr", primaries="srgb")
    assert not list(tmp_path.iterdir())


def test_first_asked_for_in_inference_mode() -> None:
    """What a probe keeps enters graphs later."""
    probe = LightProbe(random_map())
    with torch.inference_mode():
        _ = probe.solid_angles, probe.pdf(random_directions(2))
    radiance = torch.ones(9, 18, dtype=torch.float64, requires_grad=True)
    assert torch.equal(torch.autograd.grad((probe.solid_angles * radiance).sum(), radiance)[0], probe.solid_angles)
    directions = random_directions(2).requires_grad_()
    assert torch.autograd.grad(probe.pdf(directions).sum(), directions)[0].isfinite().all()
