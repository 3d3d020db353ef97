"""Exposure: albedos by hand, the pull of the prior, colours, and photographs that say nothing about it."""

from math import exp, log, sqrt

import pytest
import torch
from torch import Tensor

from torchbrdf.alignment.exposure import EXPECTED, Exposure, exposure_of
from torchbrdf.estimation.image_space import ImageSpace

PIXELS = 200
SHAPES = torch.rand(3, PIXELS, generator=torch.Generator().manual_seed(0), dtype=torch.float64) ** 4
"""Three images that are far from alike: 0.6 radians and more."""


def space_of(*columns: tuple[int, float], light: tuple[float, ...] = (1, 1, 1)) -> ImageSpace:
    """Basis images of some shapes with some albedos under light of a colour."""
    grey = torch.stack([albedo * SHAPES[shape] for shape, albedo in columns])
    return ImageSpace.of((grey[:, None] * torch.tensor(light)[:, None]).float(), [PIXELS])


def photograph(*levels: float, shape: int = 0) -> Tensor:
    """(1, 3, P): the levels of R, G and B, or of all."""
    return (torch.tensor(levels, dtype=torch.float64).expand(3)[:, None] * SHAPES[shape])[None]


def test_the_shapes_are_far_from_alike() -> None:
    unit = SHAPES / SHAPES.norm(dim=1, keepdim=True)
    assert float((unit @ unit.T - 2 * torch.eye(3)).max()) < 0.83


@pytest.mark.parametrize("white_balance", [False, True])
@pytest.mark.parametrize("factor", [0.125, 1.0, 5.0])
def test_one_albedo_of_every_shape(factor: float, white_balance: bool) -> None:
    """Nothing in doubt: the factor is what the photograph was multiplied by, and no prior pulls at it."""
    space = space_of((0, 0.4), (1, 0.1), (2, 0.9))
    found = exposure_of(photograph(factor * 0.4), space, white_balance)
    torch.testing.assert_close(found.factors, torch.full((3,), factor).double(), rtol=1e-3, atol=0)
    torch.testing.assert_close(found.std, torch.zeros(3).double(), rtol=0, atol=0.01)


@pytest.mark.parametrize("white_balance", [False, True])
@pytest.mark.parametrize("factor", [0.5, 1.0, 3.0])
def test_albedos_in_doubt(factor: float, white_balance: bool) -> None:
    """Two albedos look alike: the mean of the logarithms of both, weighed against the prior by their variance."""
    dark, bright = 0.2, 0.6
    space = space_of((0, dark), (0, bright), (1, 0.9), (2, 0.05))
    found = exposure_of(photograph(factor * sqrt(dark * bright)), space, white_balance)
    variance = (log(bright / dark) / 2) ** 2
    precision = 1 / EXPECTED**2 + 1 / variance
    expected = exp(log(factor) / variance / precision)
    torch.testing.assert_close(found.factors, torch.full((3,), expected).double(), rtol=5e-3, atol=0)
    torch.testing.assert_close(found.std, torch.full((3,), precision**-0.5).double(), rtol=5e-3, atol=0)


def test_doubling_the_photograph() -> None:
    """Doubles the factor up to the pull of the prior, a stop wide, again and again, and leaves the uncertainty."""
    assert log(2) == EXPECTED
    space = space_of((0, 0.3), (0, 0.5), (1, 0.2))
    found = [exposure_of(photograph(0.4 * 2.0**k), space, False) for k in range(-3, 4)]
    levels = torch.stack([one.factors for one in found])
    ratios = levels[1:] / levels[:-1]
    torch.testing.assert_close(ratios, ratios[:1].expand_as(ratios))
    assert 1.5 < float(ratios.min()) <= float(ratios.max()) < 2
    for one in found:
        torch.testing.assert_close(one.std, found[0].std)


def test_white_balance() -> None:
    """A factor for each channel, in that order; without, one for all, their geometric mean."""
    space = space_of((0, 0.4), (1, 0.4))
    photo = photograph(0.8, 0.4, 0.1)
    balanced, common = exposure_of(photo, space, True), exposure_of(photo, space, False)
    torch.testing.assert_close(balanced.factors, torch.tensor([2, 1, 0.25]).double(), rtol=1e-3, atol=0)
    assert torch.equal(common.factors, common.factors[:1].expand(3))
    assert torch.equal(common.std, common.std[:1].expand(3))
    spread = torch.tensor([2, 1, 0.25]).double().log()
    variance = float(spread.var(correction=0))
    said = EXPECTED**2 / (EXPECTED**2 + variance)
    assert float(common.factors[0]) == pytest.approx(exp(said * float(spread.mean())), rel=1e-3)
    assert float(common.std[0]) == pytest.approx(sqrt(said * variance), rel=1e-3)


def test_the_colour_of_the_light_is_no_white_balance() -> None:
    light = (3.0, 1.0, 0.2)
    found = exposure_of(photograph(*(0.4 * level for level in light)), space_of((0, 0.4), (1, 0.9), light=light), True)
    torch.testing.assert_close(found.factors, torch.ones(3).double(), rtol=1e-3, atol=0)


def test_what_looks_different_does_not_count() -> None:
    """Nor do images that look like the negative of the photograph."""
    alone = exposure_of(photograph(0.8), space_of((0, 0.4)), False)
    for others in ([(1, 1e-3), (2, 50.0)], [(0, -7.0)]):
        found = exposure_of(photograph(0.8), space_of((0, 0.4), *others), False)
        torch.testing.assert_close(found.factors, alone.factors, rtol=1e-3, atol=0)


def test_all_that_look_most_alike_count() -> None:
    """A photograph that nothing explains is as far from one basis BRDF as from another, and their albedos differ."""
    near, far = SHAPES[0], SHAPES[0] + 0.1 * SHAPES[1]
    grey = torch.stack([0.2 * near, 0.6 * far, SHAPES[1]])
    space = ImageSpace.of(grey[:, None].expand(3, 3, PIXELS).float(), [PIXELS])
    found = exposure_of((0.4 * (SHAPES[0] + SHAPES[2])).expand(1, 3, PIXELS), space, False)
    assert 0.35 < float(found.std[0]) < EXPECTED


@pytest.mark.parametrize("black", ["light", "photograph"])
def test_a_channel_that_says_nothing(black: str) -> None:
    """Its factor is 1, and as uncertain as before anything is seen; the others are as they are."""
    space = space_of((0, 0.4), (1, 0.7), light=(1, 1, 0 if black == "light" else 1))
    found = exposure_of(photograph(0.8, 0.4, 0), space, True)
    torch.testing.assert_close(found.factors, torch.tensor([2, 1, 1]).double(), rtol=1e-3, atol=0)
    torch.testing.assert_close(found.std, torch.tensor([0, 0, EXPECTED]).double(), rtol=0, atol=0.01)


def test_a_channel_that_says_nothing_leaves_the_common_factor_alone() -> None:
    space = space_of((0, 0.3), (0, 0.5), (1, 0.7), light=(1, 1, 0))
    found = exposure_of(photograph(0.8, 0.8, 0), space, False)
    expected = exposure_of(photograph(0.8), space_of((0, 0.3), (0, 0.5), (1, 0.7)), False)
    torch.testing.assert_close(found.factors, expected.factors)
    torch.testing.assert_close(found.std, expected.std)


def test_said_in_words() -> None:
    exposure = Exposure(torch.tensor([1.0, 2.126, 0.5]).double(), torch.tensor([0.0, 0.256, 0.5]).double())
    assert str(exposure) == "exposure of R, G, B: 1.00 +- 0 %, 2.13 +- 26 %, 0.50 +- 50 %"
