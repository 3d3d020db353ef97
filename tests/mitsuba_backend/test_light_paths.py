"""`LightPaths`: cells and weights whose mean is the radiance, for every BRDF at once and in both variants."""

from math import pi

import pytest
import torch

import torchbrdf as tb
from torchbrdf.brdf.merl import N_CELLS
from torchbrdf.light.probe import LightProbe
from torchbrdf.mitsuba_backend._light_paths import N_NUMBERS, LightPaths
from torchbrdf.view.sphere import SphereView

pytestmark = pytest.mark.usefixtures("mitsuba")


@pytest.fixture(scope="module")
def probe():
    return LightProbe.default(16)


def numbers(n_pixels, samples, seed=0):
    return torch.rand(N_NUMBERS, n_pixels, samples, generator=torch.Generator().manual_seed(seed)).clamp_(max=0.999999)


def test_shapes_and_ranges(probe):
    view = SphereView(8)
    chosen = view.pixels[3:14]
    found = LightPaths(view, probe).trace(chosen, numbers(11, 50))
    assert found.cells.shape == (11, 100)
    assert found.weights.shape == (3, 11, 100)
    assert found.cells.dtype == torch.int32
    assert int(found.cells.min()) >= 0
    assert int(found.cells.max()) < N_CELLS
    assert torch.isfinite(found.weights).all()
    assert (found.weights >= 0).all()
    assert ((found.weights > 0).any(0).double().mean((0, 1)) > 0.5).all()


@pytest.mark.parametrize("fov_deg", [None, 60.0])
def test_white_light_on_white(fov_deg):
    """The weights are the irradiance: pi from a uniform probe at every normal."""
    view = SphereView(6, fov_deg=fov_deg)
    samples = 1 << 13
    found = LightPaths(view, LightProbe(torch.ones(3, 16, 32))).trace(view.pixels, numbers(len(view.pixels), samples))
    irradiance = found.weights.double().sum(-1) / samples
    torch.testing.assert_close(irradiance, torch.full_like(irradiance, pi), rtol=0.06, atol=0)
    assert float(irradiance.mean()) == pytest.approx(pi, rel=3e-3)


@pytest.mark.parametrize("material", ["white", "satin-0.35", "copper-0.08"])
def test_the_mean_of_the_paths_is_the_radiance(probe, tiny_tables, material):
    view, table, samples = SphereView(6), tiny_tables[material], 1 << 13
    expected = view.pack(tb.render(table, probe, view, samples=8192))
    found = LightPaths(view, probe).trace(view.pixels, numbers(len(view.pixels), samples))
    values = table.filled.float()[found.cells.long()].movedim(-1, 0) * found.weights
    parts = values[..., :samples] + values[..., samples:]
    error = parts.std(-1) / samples**0.5
    z = ((parts.mean(-1) - expected) / (error + 0.003 * expected)).square().mean().sqrt()
    assert 0.3 < z < 1.5
    assert float(parts.mean() / expected.mean()) == pytest.approx(1, rel=0.01)
    assert error.norm() / expected.norm() < 0.1


def test_every_number_matters(probe):
    view = SphereView(6)
    paths, base = LightPaths(view, probe), numbers(len(view.pixels), 16)
    before = paths.trace(view.pixels, base)
    for row in range(N_NUMBERS):
        changed = base.clone()
        changed[row] = (changed[row] + 0.37) % 1
        after = paths.trace(view.pixels, changed)
        assert not torch.equal(before.weights, after.weights), row
        if row >= 4:  # the BSDF's own numbers leave the light's directions alone
            torch.testing.assert_close(before.weights[..., :16], after.weights[..., :16])


def test_scalar_and_llvm_agree(mitsuba, probe):
    view = SphereView(6)
    some = numbers(len(view.pixels), 8)
    fast = LightPaths(view, probe).trace(view.pixels, some)
    mitsuba.set_variant("scalar_rgb")
    slow = LightPaths(view, probe).trace(view.pixels, some)
    assert (fast.cells == slow.cells).double().mean() > 0.995
    assert fast.weights.shape == slow.weights.shape
    close = torch.isclose(fast.weights, slow.weights, rtol=5e-3, atol=1e-4)
    assert close.double().mean() > 0.995
    assert float(slow.weights.sum()) == pytest.approx(float(fast.weights.sum()), rel=5e-3)
