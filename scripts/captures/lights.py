"""The probe of a capture in the camera's frame, and the ones that a person might have of it."""

from dataclasses import dataclass
from math import pi, radians

import torch

from captures.plans import Plan
from torchbrdf.light import LightProbe, rotation_of
from torchbrdf.light.latlong import directions_at

HEIGHT = 256
"""Rows, at most; suns need them all."""

_SUN_RADIUS_DEG = 0.8
_MOST_CLIPPED = 0.001
"""Of the sphere: only lamps are clipped, not skies."""


def light_of(plan: Plan, probe: LightProbe) -> LightProbe:
    """The probe as it lights the ball: turned into the camera's frame, with the sun of the plan."""
    if plan.sun is not None or probe.height > HEIGHT:
        probe = probe.resized(HEIGHT)
    turned = probe.rotated(plan.rotation)
    if plan.sun is None:
        return turned
    direction, share = plan.sun
    height, width = turned.height, turned.width
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    cosine = directions_at(x.double(), y.double(), height, width) @ torch.tensor(direction, dtype=torch.float64)
    texels_off = (torch.acos(cosine.clamp(-1, 1)) - radians(_SUN_RADIUS_DEG)) * height / pi
    disc = (0.5 - texels_off).clamp(0, 1)
    power = share / (1 - share) * turned.total_power.mean() * torch.tensor([1.08, 1.0, 0.92], dtype=torch.float64)
    sun = disc * (power / (disc * turned.solid_angles).sum())[:, None, None]
    return LightProbe(turned.radiance + sun.float())


@dataclass(frozen=True)
class Clipping:
    """A probe whose brightest texels end at a limit.

    factor  by which the brightest was brighter
    texels  at the limit in some channel
    lost    share of the power
    """

    probe: LightProbe
    limit: float
    factor: float
    texels: int
    lost: float

    def described(self) -> dict[str, float]:
        """For truth.json."""
        return {"limit": self.limit, "factor": self.factor, "texels": self.texels, "lost": self.lost}


def clipped(light: LightProbe, factor: float) -> Clipping:
    """Clip by a factor, or by less where that would reach more than a thousandth of the sphere."""
    peak = light.radiance.amax(0)
    brightest = float(peak.max())
    order = peak.flatten().argsort(descending=True)
    covered = light.solid_angles.flatten()[order].cumsum(0) / (4 * pi)
    least = float(peak.flatten()[order[int((covered < _MOST_CLIPPED).sum())]])
    limit = max(brightest / factor, least)
    probe = LightProbe(light.radiance.clamp_max(limit))
    lost = 1 - float(probe.total_power.sum() / light.total_power.sum())
    return Clipping(probe, limit, brightest / limit, int((peak >= limit).sum()), lost)


def misturned(plan: Plan, light: LightProbe) -> LightProbe:
    """The probe that is turned against the truth."""
    return light.rotated(rotation_of(torch.tensor(plan.misturn, dtype=torch.float64)))
