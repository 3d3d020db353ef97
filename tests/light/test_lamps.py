"""Texels of a probe that may be clipped: which they are, and that they go where the radiance goes."""

import math
import pickle
from pathlib import Path

import pytest
import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf.light.lamps import clipped_share, lamps_of
from torchbrdf.light.latlong import row_solid_angles
from torchbrdf.light.probe import LightProbe
from turns import turn_about

HEIGHT = 64
CEILING = 40.0


def sky(height: int = HEIGHT) -> Tensor:
    """(3, H, 2 H) noise between 0.5 and 1.5: no two texels are the same."""
    return 0.5 + torch.rand(3, height, 2 * height, generator=torch.Generator().manual_seed(0))


def with_lamp(columns: slice = slice(30, 33), level: float = CEILING) -> Tensor:
    radiance = sky()
    radiance[:, 20:22, columns] = level
    return radiance


def two_lights(height: int = HEIGHT) -> Tensor:
    """(3, H, 2 H) of two smooth lights: one largest in red and green, the other in blue."""
    theta = (torch.arange(height, dtype=torch.float64) + 0.5)[:, None] * (torch.pi / height)
    phi = (torch.arange(2 * height, dtype=torch.float64) + 0.5) * (torch.pi / height)
    radiance = torch.full((3, height, 2 * height), 0.15, dtype=torch.float64)
    for polar, azimuth, width, colour in ((1.0, 2.0, 12, (6, 5, 2)), (1.4, 4.6, 15, (1, 2, 4))):
        cosine = theta.cos() * math.cos(polar) + theta.sin() * math.sin(polar) * (phi - azimuth).cos()
        radiance += torch.exp(width * (cosine - 1)) * torch.tensor(colour)[:, None, None]
    return radiance.float()


def clipped(radiance: Tensor) -> Tensor | None:
    found = lamps_of(radiance, row_solid_angles(radiance.shape[1], radiance.shape[2])[:, None])
    return None if found is None else found.radiance > 0


class TestWhichTexels:
    def test_a_plateau(self) -> None:
        radiance = with_lamp()
        assert torch.equal(clipped(radiance), radiance == CEILING)

    def test_only_channels_at_their_ceiling(self) -> None:
        """A lamp whose blue is below its ceiling keeps it."""
        radiance = with_lamp()
        radiance[2, 20:22, 30:33] = torch.linspace(5, 20, 6).view(2, 3)
        found = clipped(radiance)
        assert torch.equal(found[:2], radiance[:2] == CEILING)
        assert not found[2].any()

    def test_one_texel_at_the_level_of_another_channel(self) -> None:
        """Of a lamp clipped at one level, whose blue reaches it in the middle alone."""
        radiance = with_lamp()
        radiance[2, 20:22, 30:33] = torch.tensor([[5.0, CEILING, 7.0], [8.0, 9.0, 6.0]])
        assert torch.equal(clipped(radiance), radiance == CEILING)

    def test_across_the_seam(self) -> None:
        radiance = sky()
        radiance[:, 20, 0] = radiance[:, 20, -1] = CEILING
        assert int(clipped(radiance).sum()) == 6

    def test_one_texel_at_the_ceiling_of_all_channels(self) -> None:
        radiance = with_lamp(slice(30, 31))
        radiance[:, 21, 30] = 1.0
        assert int(clipped(radiance).sum()) == 3

    def test_the_largest_values_of_channels_in_other_places(self) -> None:
        radiance = sky()
        for channel in range(3):
            radiance[channel, 10 * channel + 5, 7] = CEILING
        assert clipped(radiance) is None

    @pytest.mark.parametrize("height", [64, 256, 512])
    def test_smooth_maxima_are_no_plateaus(self, height: int) -> None:
        """Though up to dozens of texels are within a thousandth of them."""
        radiance = two_lights(height)
        assert int((radiance == radiance.amax((1, 2), keepdim=True)).sum()) == 3
        assert clipped(radiance) is None

    @pytest.mark.parametrize("half", [False, True])
    def test_smooth_lights_that_are_clipped(self, half: bool) -> None:
        radiance = two_lights(256).clamp_max(5.875)
        radiance = radiance.half().float() if half else radiance
        found = lamps_of(radiance, row_solid_angles(256, 512)[:, None])
        assert torch.equal(found.radiance[0] > 0, radiance[0] >= 5.875 * (1 - 1e-3))
        assert int((found.radiance[0] == 5.875).sum()) > 100
        assert found.certain

    @pytest.mark.parametrize(("columns", "level"), [(slice(0, 128), CEILING), (slice(30, 33), 2.0)])
    def test_too_large_or_too_dim(self, columns: slice, level: float) -> None:
        """A bright ceiling of a room, and the brightest part of an overcast sky."""
        radiance = with_lamp(columns, level)
        radiance[:, 18:24, columns] = level
        assert clipped(radiance) is None

    def test_computed_lights_have_none(self) -> None:
        assert LightProbe.default(64).lamps is None


class TestCertain:
    def test_a_photograph_that_is_clipped(self) -> None:
        assert LightProbe(with_lamp()).lamps.certain

    def test_few_texels(self) -> None:
        radiance = sky()
        radiance[:, 20, 30:32] = CEILING
        assert not LightProbe(radiance).lamps.certain

    def test_a_picture_that_was_computed(self) -> None:
        """The default probe as others have it: its lamp is of one radiance, and so are its other lights."""
        probe = LightProbe(LightProbe.default(128).radiance)
        assert probe.lamps is not None
        assert not probe.lamps.certain

    def test_a_coloured_lamp_over_one_region(self) -> None:
        """Of one radiance, which is no ceiling that the channels share."""
        radiance = with_lamp()
        radiance[:, 20:22, 30:33] *= torch.tensor([1.0, 0.8, 0.5])[:, None, None]
        assert not LightProbe(radiance).lamps.certain

    def test_lights_of_other_colours_in_other_places(self) -> None:
        """Each of one radiance: that red and green are largest elsewhere tells nothing."""
        radiance = sky()
        radiance[:, 20:22, 30:33] = torch.tensor([40.0, 1.0, 2.0])[:, None, None]
        radiance[:, 40:42, 60:63] = torch.tensor([1.0, 30.0, 2.0])[:, None, None]
        probe = LightProbe(radiance)
        assert probe.lamps.channels.tolist() == [True, True, False]
        assert not probe.lamps.certain

    def test_a_lamp_whose_blue_is_not_clipped(self) -> None:
        """At other levels of red and green, as after a white balance."""
        radiance = with_lamp()
        radiance[1, 20:22, 30:33] *= 0.8
        radiance[2, 20:22, 30:33] = torch.linspace(5, 20, 6).view(2, 3)
        radiance[2, 40, 50] = 30.0
        assert LightProbe(radiance).lamps.certain


class TestGoesAlong:
    PROBE = LightProbe(with_lamp())

    @pytest.mark.parametrize(
        "change",
        [
            lambda probe: probe.rotated(turn_about((1, 2, -1), 30)),
            lambda probe: probe.scaled(3),
            lambda probe: probe.blurred(4),
            lambda probe: probe.resized(40),
        ],
        ids=["rotated", "scaled", "blurred", "resized"],
    )
    def test_as_the_radiance_does(self, change: object) -> None:
        """Brightened before is brightened after."""
        factors = torch.tensor([5.0, 7.0, 9.0])
        before, after = change(self.PROBE.relit(factors)), change(self.PROBE).relit(factors)
        torch.testing.assert_close(after.radiance, before.radiance, rtol=1e-4, atol=1e-4)

    def test_factors(self) -> None:
        radiance = self.PROBE.relit(torch.tensor([2.0, 3.0, 4.0])).radiance
        assert radiance[:, 20, 30].tolist() == [2 * CEILING, 3 * CEILING, 4 * CEILING]
        assert torch.equal(radiance[:, :20], self.PROBE.radiance[:, :20])

    def test_known_then(self) -> None:
        probe = self.PROBE.relit(torch.ones(3))
        assert probe.lamps is None
        with pytest.raises(ValueError, match=r"^light probe has no texels that may be clipped$"):
            probe.relit(torch.ones(3))

    def test_other_factors(self) -> None:
        with pytest.raises(ValueError, match=r"^factors of lamps must be three finite numbers of at least 0, got"):
            self.PROBE.relit(torch.tensor([1.0, math.nan, 1.0]))

    def test_pickled(self) -> None:
        copy = pickle.loads(pickle.dumps(self.PROBE.rotated(turn_about((0, 1, 0), 10))))
        assert copy.lamps.about == self.PROBE.lamps.about


class TestFiles:
    @pytest.mark.parametrize("layout", ["latlong", "angular", "mirror_ball", "horizontal_cross"])
    def test_found_in_the_pixels_of_the_file(self, tmp_path: Path, layout: str) -> None:
        """Which resampling to 512 rows blurs; the rest of the light is that of the file without its lamp."""
        height, width = {"latlong": (64, 128), "horizontal_cross": (48, 64)}.get(layout, (64, 64))
        picture = 0.5 + torch.rand(3, height, width, generator=torch.Generator().manual_seed(1))
        picture[:, 20:22, 28:31] = CEILING
        dark = picture.clone()
        dark[:, 20:22, 28:31] = 0
        for name, image in (("lit", picture), ("dark", dark)):
            tb.write_image(tmp_path / f"{name}.exr", image)
        lit = LightProbe.open(tmp_path / "lit.exr", layout)
        assert lit.lamps.about == "6 texels of radiance 40 (rows 20 to 21, columns 28 to 30, counted from 0)"
        off = lit.relit(torch.zeros(3)).radiance - LightProbe.open(tmp_path / "dark.exr", layout).radiance
        assert float(off.abs().max()) < 1e-3

    def test_saved_and_opened(self, tmp_path: Path) -> None:
        """A radiance that was found is not doubted again."""
        TestGoesAlong.PROBE.save(tmp_path / "given.exr")
        TestGoesAlong.PROBE.relit(torch.full((3,), 9.0)).save(tmp_path / "found.exr")
        assert LightProbe.open(tmp_path / "given.exr").lamps is not None
        assert LightProbe.open(tmp_path / "found.exr").lamps is None


class TestInfinite:
    def test_at_the_largest_finite_radiance(self) -> None:
        radiance = sky()
        radiance[:2, 20:22, 30] = math.inf
        probe = LightProbe(radiance, unknown_lamps=True)
        largest = float(sky().max())
        assert probe.radiance[:, 20, 30].tolist() == [largest, largest, float(radiance[2, 20, 30])]
        assert probe.lamps.unknown
        assert probe.lamps.certain
        assert probe.lamps.channels.tolist() == [True, True, False]
        assert probe.lamps.about == "2 texels of infinite radiance (rows 20 to 21, column 30, counted from 0)"

    def test_in_a_file(self, tmp_path: Path) -> None:
        radiance = sky()
        radiance[:, 20, 30:32] = math.inf
        tb.write_image(tmp_path / "probe.exr", radiance)
        probe = LightProbe.open(tmp_path / "probe.exr", unknown_lamps=True)
        assert probe.lamps.unknown
        assert bool(torch.isfinite(probe.radiance).all())

    def test_more_than_lamps_is_refused(self) -> None:
        radiance = torch.ones(3, 32, 64)
        radiance[:, 12:20, :20] = torch.inf
        with pytest.raises(ValueError, match=r"^light probe is infinite in 1\d\.\d% of the sphere: that is more"):
            LightProbe(radiance, unknown_lamps=True)

    def test_refused_otherwise(self) -> None:
        radiance = sky()
        radiance[:, 20, 30:32] = math.inf
        with pytest.raises(ValueError, match=r"`torchbrdf fit --align` finds its radiance, .* \(unknown_lamps=True"):
            LightProbe(radiance)

    @pytest.mark.parametrize("turn", [None, turn_about((0.0, 1.0, 0.0), 20.0)])
    def test_saved_they_are_infinite_again(self, tmp_path: Path, turn: Tensor | None) -> None:
        radiance = sky()
        radiance[:, 20, 30:33] = math.inf
        probe = LightProbe(radiance, unknown_lamps=True)
        (probe if turn is None else probe.rotated(turn)).save(tmp_path / "probe.exr")
        found = LightProbe.open(tmp_path / "probe.exr", unknown_lamps=True).lamps
        assert found.unknown
        assert int((found.radiance > 0).sum()) == (9 if turn is None else pytest.approx(9, abs=3))


def panorama(seed: int = 0) -> Tensor:
    """(3, 64, 128): smooth light from 0 to 3, with some noise, more of it red."""
    theta = (torch.arange(64) + 0.5)[:, None] * (torch.pi / 64)
    light = 1.5 * (1 + torch.cos(theta) * torch.linspace(0.5, 1, 128))
    noise = torch.rand(3, 64, 128, generator=torch.Generator().manual_seed(seed))
    return light * torch.tensor([1.1, 1.0, 0.9])[:, None, None] + 0.1 * noise


def share_clipped(radiance: Tensor) -> float:
    probe = LightProbe(radiance)
    return clipped_share(probe.radiance, probe.solid_angles)


def test_more_than_lamps_that_is_clipped_is_told_with_its_share():
    clipped = panorama().clamp_max(2.0)
    probe = LightProbe(clipped)
    expected = float((probe.solid_angles * (clipped > 1.998).any(0)).sum() / probe.solid_angles.sum())
    assert expected > 0.1
    assert share_clipped(clipped) == pytest.approx(expected, rel=1e-5)
    assert share_clipped(probe.resized(128).radiance) == pytest.approx(expected, rel=0.05)


def test_light_that_is_not_clipped_or_was_computed_is_not_said_to_be():
    assert share_clipped(panorama()) == 0.0
    assert share_clipped(torch.ones(3, 16, 32)) == 0.0
    assert share_clipped(torch.zeros(3, 16, 32) + 1e-6) == 0.0
    half = torch.full((3, 64, 128), 0.2)
    half[:, :32] = 1.0
    assert share_clipped(half) == 0.0
    assert share_clipped(LightProbe.default(128).radiance) == 0.0
    window = panorama()
    window[:, 5:20, 10:60] = torch.tensor([9.0, 8.0, 7.0])[:, None, None]  # one area, one radiance, in every channel
    assert share_clipped(window) == 0.0
    assert share_clipped(LightProbe.default(128).radiance.clamp_max(1.0)) > 0.05
