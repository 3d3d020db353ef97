"""How much brighter a photograph is than its light and a material of the library account for.

Exposure and albedo look the same: only the materials that look like the photographed one, with their true albedo, tell
them apart. So the brightness of the photograph is compared with theirs, and their spread is the uncertainty.
"""

from dataclasses import dataclass
from math import log

import torch
from torch import Tensor

from torchbrdf.estimation import ImageSpace

EXPECTED = log(2)
"""Standard deviation of the logarithm of the exposure before anything is seen: a stop."""

REACH = 0.1
"""Radians between weighted images over which basis BRDFs count as alike, from the one most alike."""


@dataclass(frozen=True, eq=False)
class Exposure:
    """What a photograph has to be divided by, for each colour channel.

    factors  (3,) float64; all the same without white balance
    std      (3,) float64: standard deviations of their natural logarithms
    """

    factors: Tensor
    std: Tensor

    def __str__(self) -> str:
        """The factors with how uncertain they are."""
        pairs = zip(self.factors.tolist(), self.std.tolist(), strict=True)
        return "exposure of R, G, B: " + ", ".join(f"{factor:.2f} +- {100 * std:.0f} %" for factor, std in pairs)


def exposure_of(y: Tensor, space: ImageSpace, white_balance: bool) -> Exposure:
    """The exposure of a photograph (1, 3, P) under the light of a space of basis images.

    Each basis BRDF, scaled to fit a channel best, says what the exposure would be. They are weighed by how much they
    look like the photograph, and their mean by a prior of EXPECTED around 1.
    white_balance  a factor for each channel; else one for all
    """
    coordinates, energy = space.project(y)
    aligned = torch.einsum("sr,srn->sn", coordinates[0], space.r)
    lit = (space.energy > 0) & (aligned > 0)
    size = torch.where(lit, space.energy, 1)
    angle = torch.acos((aligned / (size * energy[0][:, None].clamp_min(1e-300)).sqrt()).clamp(-1, 1))
    angle = torch.where(lit, angle, torch.pi)
    alike = torch.exp(-(((angle - angle.amin(1, keepdim=True)) / REACH) ** 2)) * lit
    scale = torch.where(lit, aligned / size, 1).log()
    if not white_balance:
        alike, scale = alike.reshape(1, -1), scale.reshape(1, -1)
    total = alike.sum(1, keepdim=True)
    told, total = total > 0, total.clamp_min(1e-12)
    mean = (alike * scale).sum(1, keepdim=True) / total
    variance = (alike * (scale - mean) ** 2).sum(1, keepdim=True) / total
    said = torch.where(told, EXPECTED**2 / (EXPECTED**2 + variance), 0)
    std = torch.where(told, (said * variance).sqrt(), EXPECTED)
    return Exposure((said * mean).exp().expand(3, 1)[:, 0], std.expand(3, 1)[:, 0])
