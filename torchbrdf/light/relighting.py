"""Lights to show a material under that was photographed under one of them."""

from math import radians

import torch

from torchbrdf.light.probe import LightProbe
from torchbrdf.light.rotations import rotation_of

_UP = torch.tensor([0, 1, 0], dtype=torch.float64)


def turned(probe: LightProbe, degrees: float) -> LightProbe:
    """The probe turned about the vertical, counterclockwise seen from above: the camera went round the other way."""
    return probe.rotated(rotation_of(radians(degrees) * _UP))


def other_lights(probe: LightProbe) -> list[LightProbe]:
    """The same light from three other sides, and the embedded one, a studio room, from three."""
    room = LightProbe.default()
    return [*(turned(probe, angle) for angle in (90, 180, 270)), *(turned(room, angle) for angle in (0, 120, 240))]
