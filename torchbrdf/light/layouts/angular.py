"""Angular maps, Debevec's `*_probe`: the centre looks forward, along -Z, and the rim is straight behind, +Z [Deb98].

The angle from -Z is pi sqrt(u^2 + v^2).
"""

import math

import torch
from torch import Tensor

from torchbrdf.light.layouts._disc import DiscLayout


def coordinates(directions: Tensor) -> Tensor:
    """u and v (..., 2) of unit directions (..., 3)."""
    d_x, d_y, d_z = directions.unbind(-1)
    sine = torch.hypot(d_x, d_y)
    radius = torch.atan2(sine, -d_z) / math.pi
    return directions[..., :2] * (radius / sine.clamp_min(1e-12))[..., None]


LAYOUT = DiscLayout(coordinates, solid_angle=torch.sinc, edge=0.0)
