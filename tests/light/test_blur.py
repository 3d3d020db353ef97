"""Blurred probes: spherical harmonics decay as under the heat equation; energy, sign, seam, poles, bad input."""

import math

import pytest
import torch
from hypothesis import given, settings, strategies as st
from torch import Tensor

from probes import probe_of, texel_directions
from torchbrdf.light.probe import LightProbe

LEGENDRE = {1: lambda x: x, 2: lambda x: 1.5 * x**2 - 0.5, 3: lambda x: 2.5 * x**3 - 1.5 * x}


def point(row: int, column: int, height: int = 64, background: float = 0.0) -> LightProbe:
    """One bright texel."""
    radiance = torch.full((3, height, 2 * height), background)
    radiance[:, row, column] = 1e5
    return LightProbe(radiance)


def spread(probe: LightProbe, centre: Tensor) -> float:
    """Degrees: sigma of the Gaussian on the sphere of the same mean cosine, which is exp(-sigma^2)."""
    power = probe.radiance[0].double() * probe.solid_angles
    cosine = float((power * (texel_directions(probe.height) @ centre).double()).sum() / power.sum())
    return math.degrees(math.sqrt(-math.log(cosine)))


class TestGaussian:
    @pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.48, -0.6, 0.64)])
    @pytest.mark.parametrize("degree", [1, 2, 3])
    def test_harmonics_decay(self, axis: tuple[float, ...], degree: int) -> None:
        """P_l becomes exp(-l (l + 1) sigma^2 / 2) P_l, and stays P_l, about every axis."""
        wave = LEGENDRE[degree](texel_directions(64) @ torch.tensor(axis)).double()
        probe = probe_of(lambda d: 1 + 0.9 * LEGENDRE[degree](d @ torch.tensor(axis)))
        for sigma in (2.0, 10.0, 15.0):
            decay = math.exp(-degree * (degree + 1) * math.radians(sigma) ** 2 / 2)
            left = probe.blurred(sigma).radiance[0].double() - 1
            assert float((left - 0.9 * decay * wave).abs().max()) < 0.01
            kept = float((left * wave * probe.solid_angles).sum() / (wave**2 * probe.solid_angles).sum())
            assert 1 - kept / 0.9 == pytest.approx(1 - decay, rel=0.03)

    @pytest.mark.parametrize("row", [32, 16, 5])
    def test_width(self, row: int) -> None:
        for sigma in (1.0, 5.0, 15.0):
            centre = texel_directions(64)[row, 20]
            assert spread(point(row, 20).blurred(sigma), centre) == pytest.approx(sigma, rel=0.02)

    @pytest.mark.parametrize("row", [0, 63])
    def test_width_at_the_poles(self, row: int) -> None:
        """The rows are 2.9 degrees apart, and the pole is a texel of another shape."""
        probe = point(row, 0)
        for sigma, tolerance in ((5.0, 0.05), (15.0, 0.02)):
            assert spread(probe.blurred(sigma), texel_directions(64)[row, 0]) == pytest.approx(sigma, rel=tolerance)

    def test_profile(self) -> None:
        """exp(-angle^2 / (2 sigma^2)) / (2 pi sigma^2) along a row and a column, but for the few steps it takes."""
        sigma = math.radians(8)
        probe = point(64, 128, height=129)
        image = probe.blurred(8.0).radiance[0] / float(probe.total_power[0]) * (2 * math.pi * sigma**2)
        for along, step in ((image[64, 128:], 2 * math.pi / 258), (image[64:, 128], math.pi / 128)):
            expected = torch.exp(-((step * torch.arange(len(along))) ** 2) / (2 * sigma**2))
            assert float((along - expected).abs().max()) < 0.2
            assert float((along - expected)[expected < 0.8].abs().max()) < 0.07

    def test_two_blurs_are_one(self) -> None:
        room = LightProbe.default(32)
        twice, once = room.blurred(6).blurred(8).radiance, room.blurred(10).radiance
        assert float((twice - once).norm() / once.norm()) < 0.03
        assert float((room.radiance - once).norm() / once.norm()) > 1

    def test_very_wide(self) -> None:
        """Nothing but the mean is left."""
        room = LightProbe.default(32)
        expected = room.mean_radiance.float()[:, None, None].expand(3, 32, 64)
        torch.testing.assert_close(room.blurred(1000).radiance, expected, rtol=1e-3, atol=0)


class TestProbe:
    @given(st.floats(0.01, 90), st.integers(2, 12), st.integers(0, 1000))
    @settings(max_examples=30)
    def test_energy_is_kept(self, sigma: float, height: int, seed: int) -> None:
        generator = torch.Generator().manual_seed(seed)
        probe = LightProbe(torch.rand(3, height, 2 * height, generator=generator) ** 4)
        torch.testing.assert_close(probe.blurred(sigma).total_power, probe.total_power, rtol=1e-6, atol=0)

    @pytest.mark.parametrize(("row", "column"), [(0, 3), (1, 0), (20, 64), (32, 127), (63, 1)])
    @pytest.mark.parametrize("sigma", [0.1, 1.0, 6.0, 40.0])
    def test_never_negative(self, row: int, column: int, sigma: float) -> None:
        """A lamp in the dark, and its energy."""
        probe = point(row, column)
        blurred = probe.blurred(sigma)
        assert float(blurred.radiance.min()) >= 0
        torch.testing.assert_close(blurred.total_power, probe.total_power, rtol=1e-6, atol=0)

    def test_no_brighter_and_no_darker(self) -> None:
        room = LightProbe.default(64)
        for channel, blurred in zip(room.radiance, room.blurred(2).radiance, strict=True):
            assert channel.min() * (1 - 1e-5) <= blurred.min()
            assert blurred.max() < channel.max()

    @pytest.mark.parametrize("columns", [1, 31, 64])
    def test_the_seam_is_nothing_special(self, columns: int) -> None:
        room = LightProbe.default(32)
        turned = LightProbe(room.radiance.roll(columns, -1)).blurred(5)
        torch.testing.assert_close(turned.radiance, room.blurred(5).radiance.roll(columns, -1), rtol=1e-5, atol=0)

    def test_the_poles_are_alike(self) -> None:
        room = LightProbe.default(32)
        flipped = LightProbe(room.radiance.flip(1)).blurred(5)
        torch.testing.assert_close(flipped.radiance, room.blurred(5).radiance.flip(1), rtol=1e-5, atol=0)

    def test_a_pole_has_one_value(self) -> None:
        blurred = LightProbe.default(32).blurred(3).radiance
        for row in (0, -1):
            torch.testing.assert_close(blurred[:, row], blurred[:, row, :1].expand(3, 64), rtol=1e-5, atol=0)

    def test_across_a_pole(self) -> None:
        """Light beside a pole reaches the other side of it, at the same distance as on its own side."""
        image = point(2, 0).blurred(8).radiance[0]
        assert float(image[2, 64] / image[6, 0]) == pytest.approx(1, rel=0.05)  # both are 4 rows away

    def test_agrees_with_a_turned_probe(self) -> None:
        """The blur is the same in every direction: turning first or last makes no difference."""
        probe = probe_of(lambda d: 0.1 + torch.exp(40 * (d @ torch.tensor([0.0, 0.96, 0.28]) - 1)))
        quarter = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
        one, other = probe.rotated(quarter).blurred(10).radiance, probe.blurred(10).rotated(quarter).radiance
        assert float((one - other).norm() / one.norm()) < 5e-3

    def test_no_blur(self) -> None:
        probe = LightProbe.default(16)
        assert probe.blurred(0) is probe
        assert torch.equal(probe.blurred(0.0).radiance, LightProbe.default(16).radiance)

    def test_is_a_probe_like_others(self) -> None:
        room = LightProbe.default(16)
        blurred = room.blurred(4)
        assert (blurred.name, blurred.radiance.shape, blurred.radiance.dtype) == (room.name, (3, 16, 32), torch.float32)
        assert blurred.fingerprint != room.fingerprint
        assert torch.equal(room.radiance, LightProbe.default(16).radiance)
        assert torch.equal(blurred.radiance, room.blurred(4).radiance)

    @pytest.mark.parametrize("degrees", [-1.0, float("nan"), float("inf")])
    def test_bad_widths(self, degrees: float) -> None:
        message = rf"^blur of a light probe must be at least 0 degrees and finite, got {degrees}$"
        with pytest.raises(ValueError, match=message):
            LightProbe.default(16).blurred(degrees)
