"""What `torchbrdf fit --align` says of lamps that may be clipped, and of turns and blurs that are not sure."""

import math
import warnings
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

from torchbrdf.alignment.lamps import LampRadiance
from torchbrdf.commands._alignment import warn_of_blur, warn_of_lamps, warn_of_turn
from torchbrdf.light.probe import LightProbe


def sky(texels: int) -> Tensor:
    """(3, 32, 64) noise, with so many texels at one maximum."""
    radiance = 0.5 + torch.rand(3, 32, 64, generator=torch.Generator().manual_seed(0))
    radiance[:, 10, 20 : 20 + texels] = 30.0
    return radiance


def found(probe: LightProbe, std: float, log_odds: float = math.inf) -> SimpleNamespace:
    ones = torch.ones(3, dtype=torch.float64)
    return SimpleNamespace(lamp=LampRadiance(probe.lamps, ones, std * ones, log_odds))


def test_what_the_photograph_cannot_tell() -> None:
    probe = LightProbe(sky(5))
    with pytest.warns(UserWarning, match="this photograph cannot tell their radiance for sure"):
        warn_of_lamps(probe, found(probe, 2.0))


def test_what_the_photograph_tells_is_said_to_be_no_measurement() -> None:
    probe = LightProbe(sky(5))
    told = r"5 texels of radiance 30 .* which the photograph tells, to 10%, and the BRDF is off"
    with pytest.warns(UserWarning, match=told):
        warn_of_lamps(probe, found(probe, 0.1))


def test_a_few_texels_that_are_clipped_and_cannot_be_told() -> None:
    probe = LightProbe(sky(2))
    with pytest.warns(UserWarning, match="this photograph cannot tell their radiance for sure"):
        warn_of_lamps(probe, found(probe, 2.0))


def test_nothing_is_said_of_a_lamp_that_is_as_it_was_recorded() -> None:
    probe = LightProbe(sky(5))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_lamps(probe, found(probe, 0.1, -1.0))


@pytest.mark.parametrize("blur", [0.0, 3.5])
def test_a_blur_is_said_to_be_doubtful(blur: float) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_blur(SimpleNamespace(blur=blur))
    assert len(caught) == (blur > 0)


@pytest.mark.parametrize(("angle", "confident", "said"), [(8.0, False, True), (8.0, True, False), (0.0, False, False)])
def test_a_turn_that_is_not_sure(angle: float, confident: bool, said: bool) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn_of_turn(SimpleNamespace(angle=angle, confident=confident, uncertainty=3.4))
    assert len(caught) == said
    assert all(str(one.message).startswith("the light probe is turned by 8.0 degrees, +- 3.4") for one in caught)
