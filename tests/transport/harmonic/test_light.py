"""A probe's Fourier series about the view direction: closed forms, energy, turns, gradients."""

import math
from math import pi

import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from probes import lamps, probe_of
from torchbrdf.light.probe import LightProbe
from torchbrdf.transport.harmonic.grid import Zone, zones
from torchbrdf.transport.harmonic.light import TurningLight
from torchbrdf.transport.harmonic.splines import design_matrix


def spectra(probe: LightProbe, rotation: Tensor | None = None) -> list[tuple[Zone, Tensor]]:
    """The complex coefficients (M, 3, elevations) of every zone."""
    light = [parts for parts, _ in TurningLight(probe).harmonics(rotation)]
    return [(zone, torch.complex(part[:, :3], part[:, 3:])) for zone, part in zip(zones(), light, strict=True)]


def on_lines(zone: Zone, spectrum: Tensor, beta: Tensor) -> Tensor:
    """(M, 3, N): the Fourier coefficients at polar angles beta (N,)."""
    design = design_matrix(beta * (zone.rows / pi), zone.rows)
    return spectrum.to(torch.complex128) @ design.T.to(torch.complex128)


def power(probe: LightProbe, rotation: Tensor | None = None) -> Tensor:
    """(zones, 3): the integral over the sphere, from the coefficients."""
    return torch.stack([2 * pi * (s[0].real.double() @ zone.row_measure) for zone, s in spectra(probe, rotation)])


def turn(*degrees: float) -> Tensor:
    return torch.from_numpy(Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()).float()


BETA = torch.linspace(0.1, pi - 0.1, 200, dtype=torch.float64)
"""Away from the ends, where the splines have hardly any measure."""

SMOOTH = probe_of(lambda d: 1 + 0.5 * d[..., 0] * d[..., 1] + 0.3 * d[..., 2] ** 3 + 0.4 * d[..., 1], 64)


@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode])
@pytest.mark.parametrize("turned", [False, True])
def test_gradients_flow_where_it_was_first_seen_without(mode: type, turned: bool) -> None:
    """Those of what it is multiplied with, and where the radiance has some, of the radiance."""
    rotation = turn(3, 0, 0) if turned else None
    for radiance in (torch.ones(3, 16, 32), torch.ones(3, 16, 32, requires_grad=True)):
        light = TurningLight(LightProbe(radiance))
        with mode():
            light.spectra(rotation)
        weights = torch.ones((), requires_grad=True)
        (weights * light.spectra(rotation)[0].abs().sum()).backward()
        assert float(weights.grad) > 0
        assert radiance.grad is None or bool((radiance.grad != 0).any())
        assert (radiance.grad is not None) == radiance.requires_grad


class TestClosedForms:
    def test_uniform(self) -> None:
        probe = LightProbe(torch.tensor([1.0, 2.0, 0.5])[:, None, None].expand(3, 32, 64))
        for zone, spectrum in spectra(probe):
            assert spectrum.shape == (zone.frequencies, 3, zone.elevations)
            found = on_lines(zone, spectrum, BETA)
            expected = torch.tensor([1.0, 2.0, 0.5], dtype=torch.complex128)[:, None].expand(3, len(BETA))
            torch.testing.assert_close(found[0], expected, rtol=3e-3, atol=0)
            assert float(found[1:].abs().max()) < 1e-6

    def test_uniform_at_the_ends(self) -> None:
        """Light straight along the view axis, as at every other place."""
        for zone, spectrum in spectra(LightProbe(torch.ones(3, 32, 64))):
            found = on_lines(zone, spectrum, torch.tensor([0.0, 0.005, pi - 0.005, pi], dtype=torch.float64))
            torch.testing.assert_close(found[0].real, torch.ones_like(found[0].real), rtol=0.01, atol=0)

    @pytest.mark.parametrize("axis", ["x", "y", "z"])
    def test_linear(self, axis: str) -> None:
        """cos beta for z; sin beta / 2 for x and -i sin beta / 2 for y at frequency 1: azimuth is from +X to +Y."""
        sine, cosine, zero = torch.sin(BETA), torch.cos(BETA), torch.zeros_like(BETA)
        expected = {
            "x": (1 + zero, sine / 2 + 0j),
            "y": (1 + zero, -0.5j * sine),
            "z": (1 + cosine, zero + 0j),
        }[axis]
        for zone, spectrum in spectra(probe_of(lambda d: 1 + d[..., "xyz".index(axis)], 64)):
            found = on_lines(zone, spectrum, BETA)
            torch.testing.assert_close(found[0].real, expected[0].expand(3, -1), rtol=0, atol=5e-3)
            torch.testing.assert_close(found[1], expected[1].expand(3, -1), rtol=0, atol=1e-3)
            assert float(found[2:].abs().max()) < 5e-4

    def test_multiple_is_i_times(self) -> None:
        for light, turned in TurningLight(SMOOTH).harmonics():
            assert torch.equal(turned, torch.cat([-light[:, 3:], light[:, :3]], 1))

    def test_channels_stay_apart(self) -> None:
        radiance = torch.zeros(3, 16, 32)
        radiance[2] = 1 + torch.rand(16, 32, generator=torch.Generator().manual_seed(0))
        for _, spectrum in spectra(LightProbe(radiance)):
            assert float(spectrum[:, :2].abs().max()) == 0
            assert float(spectrum[0, 2].abs().max()) > 1


class TestEnergy:
    @pytest.mark.parametrize("height", [2, 3, 8, 32])
    def test_of_noise(self, height: int) -> None:
        radiance = torch.rand(3, height, 2 * height, generator=torch.Generator().manual_seed(height)) ** 4
        probe = LightProbe(radiance)
        torch.testing.assert_close(power(probe), probe.total_power.expand(4, 3), rtol=1e-4, atol=0)

    @pytest.mark.parametrize("height", [600, 640, 900])
    def test_of_fine_noise(self, height: int) -> None:
        radiance = torch.rand(3, height, 2 * height, generator=torch.Generator().manual_seed(height)) ** 4
        probe = LightProbe(radiance)
        torch.testing.assert_close(power(probe), probe.total_power.expand(4, 3), rtol=1e-3, atol=0)

    @pytest.mark.parametrize("height", [2, 8, 64, 128])
    @pytest.mark.parametrize("row", [0, -1])
    def test_of_a_lamp_at_a_pole(self, height: int, row: int) -> None:
        radiance = torch.full((3, height, 2 * height), 0.01)
        radiance[:, row] = 1000
        probe = LightProbe(radiance)
        torch.testing.assert_close(power(probe), probe.total_power.expand(4, 3), rtol=2e-3, atol=0)

    @pytest.mark.parametrize("towards", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.0, -0.8), (0.05, -1.0, 0.0)])
    def test_of_a_lamp_as_wide_as_the_sun_seen_in_haze(self, towards: tuple[float, ...]) -> None:
        """A disc of 3 degrees in a fine probe, at the probe's poles, the view's and elsewhere."""
        axis = torch.nn.functional.normalize(torch.tensor(towards), dim=0)
        probe = probe_of(lambda d: torch.where(d @ axis > math.cos(math.radians(1.5)), 1e4, 0.01), 512)
        torch.testing.assert_close(power(probe), probe.total_power.expand(4, 3), rtol=2e-2, atol=0)

    @pytest.mark.parametrize(
        ("height", "row", "column", "tolerance"),
        [(512, 0, 0, 0.04), (512, 256, 170, 0.02), (601, 0, 0, 0.04), (128, 1, 3, 0.01), (128, 64, 20, 0.005)],
    )
    def test_of_one_texel(self, height: int, row: int, column: int, tolerance: float) -> None:
        """The hardest light; 576 lines do not integrate the hat of one texel of half a degree or less exactly."""
        radiance = torch.full((3, height, 2 * height), 0.01)
        radiance[:, row, slice(None) if row == 0 else column] = 1000
        probe = LightProbe(radiance)
        torch.testing.assert_close(power(probe), probe.total_power.expand(4, 3), rtol=tolerance, atol=0)

    def test_of_a_turned_probe(self) -> None:
        probe = lamps(64)
        expected = probe.total_power.expand(4, 3)
        torch.testing.assert_close(power(probe, turn(20, 50, -70)), expected, rtol=2e-3, atol=0)


class TestTurns:
    ANGLE = 0.7

    def test_a_turn_about_the_view_axis_is_a_phase(self) -> None:
        upright, turned = spectra(SMOOTH), spectra(SMOOTH, turn(0, 0, math.degrees(self.ANGLE)))
        for (zone, before), (_, after) in zip(upright, turned, strict=True):
            phase = torch.exp(-1j * self.ANGLE * torch.arange(zone.frequencies))
            torch.testing.assert_close(after, before * phase[:, None, None], rtol=0, atol=1e-5)
            assert float((after - before).abs().max()) > 0.1

    def test_phase_agrees_with_looking_radiance_up_in_turned_directions(self) -> None:
        rotation = turn(0, 0, math.degrees(self.ANGLE))
        for (_, phase), (_, general) in zip(
            spectra(SMOOTH, rotation), spectra(SMOOTH, rotation.clone().requires_grad_()), strict=True
        ):
            torch.testing.assert_close(phase, general.detach(), rtol=0, atol=1e-3)

    @pytest.mark.parametrize("degrees", [(0, 0, 40), (30, -50, 110), (180, 0, 0), (0, 180, 0)])
    def test_convention_is_that_of_rotated(self, degrees: tuple[float, ...]) -> None:
        rotation = turn(*degrees)
        for (zone, found), (_, expected) in zip(
            spectra(SMOOTH, rotation), spectra(SMOOTH.rotated(rotation)), strict=True
        ):
            found, expected = (on_lines(zone, spectrum, BETA)[:8] for spectrum in (found, expected))
            torch.testing.assert_close(found, expected, rtol=0, atol=3e-3)

    def test_values_of_a_turned_linear_map(self) -> None:
        """L = 1 + x with +X turned to +Z is 1 + z: radiance that came from d comes from R d."""
        rotation = turn(0, -90, 0)
        assert torch.allclose(rotation @ torch.tensor([1.0, 0, 0]), torch.tensor([0.0, 0, 1]), atol=1e-6)
        for zone, spectrum in spectra(probe_of(lambda d: 1 + d[..., 0], 64), rotation):
            found = on_lines(zone, spectrum, BETA)
            torch.testing.assert_close(found[0].real, (1 + torch.cos(BETA)).expand(3, -1), rtol=0, atol=5e-3)
            assert float(found[1:].abs().max()) < 1e-3

    def test_no_turn_at_all(self) -> None:
        for (_, none), (_, unit) in zip(spectra(SMOOTH), spectra(SMOOTH, torch.eye(3)), strict=True):
            torch.testing.assert_close(none, unit)


class TestGradients:
    @pytest.mark.parametrize("degrees", [None, (0, 0, 25), (40, 10, -60)])
    def test_reach_the_radiance(self, degrees: tuple[float, ...] | None) -> None:
        """The coefficients are linear in the radiance, so a difference of any size tells the derivative."""
        generator = torch.Generator().manual_seed(3)
        rotation = None if degrees is None else turn(*degrees)
        direction = torch.rand(3, 16, 32, generator=generator)
        light = TurningLight(LightProbe(torch.ones(3, 16, 32))).harmonics(rotation)
        weights = [torch.randn(part.shape, generator=generator) for part, _ in light]

        def total(radiance: Tensor) -> Tensor:
            parts = TurningLight(LightProbe(radiance)).harmonics(rotation)
            return sum((part.double() * w).sum() for (part, _), w in zip(parts, weights, strict=True))

        radiance = torch.ones(3, 16, 32, requires_grad=True)
        total(radiance).backward()
        assert radiance.grad is not None
        expected = float(total(1 + direction) - total(torch.ones(3, 16, 32)))
        assert float((radiance.grad * direction).sum()) == pytest.approx(expected, rel=1e-3)

    def test_reach_every_texel(self) -> None:
        radiance = torch.ones(3, 16, 32, requires_grad=True)
        light = TurningLight(LightProbe(radiance)).harmonics()
        light[0][0][0, :3].sum().backward()
        assert radiance.grad is not None
        assert bool((radiance.grad != 0).all())


class TestChanges:
    def test_of_turns_about_each_axis(self) -> None:
        """Against differences of the coefficients, after a turn."""
        fine = probe_of(lambda d: 1 + 0.5 * d[..., 0] * d[..., 1] + 0.3 * d[..., 2] ** 3 + 0.4 * d[..., 1], 256)
        light, before = TurningLight(fine), turn(20, -40, 10)
        step = math.radians(1)
        changes = light.changes(before.double())
        for axis, degrees in enumerate(torch.eye(3)):
            ahead, behind = (turn(*(sign * degrees).tolist()) @ before for sign in (1, -1))
            each = zip(zones(), light.harmonics(ahead), light.harmonics(behind), changes, strict=True)
            for zone, (after, _), (earlier, _), (change, _) in each:
                expected = on_lines(zone, ((after - earlier) / (2 * step)).cfloat(), BETA)
                found = on_lines(zone, change.unflatten(1, (2, 3, 3))[:, :, axis].flatten(1, 2).cfloat(), BETA)
                assert float((found - expected).norm()) < 0.01 * float(expected.norm())

    def test_multiples(self) -> None:
        for change, multiple in TurningLight(SMOOTH).changes(turn(20, -40, 10).double()):
            real, imaginary = change.chunk(2, 1)
            assert torch.equal(multiple, torch.cat([-imaginary, real], 1))

    def test_uniform_light_has_none(self) -> None:
        for found, _ in TurningLight(LightProbe(torch.ones(3, 16, 32))).changes(turn(20, -40, 10).double()):
            assert float(found.abs().max()) < 1e-3

    def test_few_frequencies(self) -> None:
        """The lowest, as of all."""
        few, every = (TurningLight(SMOOTH, most=most) for most in (9, None))
        for render in (TurningLight.harmonics, TurningLight.changes):
            rotation = turn(20, -40, 10)
            for (found, _), (expected, _) in zip(render(few, rotation), render(every, rotation), strict=True):
                assert len(found) == 9
                torch.testing.assert_close(found, expected[:9], rtol=1e-4, atol=1e-5)
