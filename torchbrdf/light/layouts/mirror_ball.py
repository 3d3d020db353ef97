"""Mirror balls: photographs of a perfectly reflecting sphere by a distant camera that looks along -Z.

The normal is (u, v, sqrt(1 - u^2 - v^2)), so the centre shows what is behind the camera, +Z, and the rim -Z. All pixels
have the same solid angle.
"""

import math

import torch
from torch import Tensor

from torchbrdf.light.layouts._disc import DiscLayout


def coordinates(directions: Tensor) -> Tensor:
    """u and v (..., 2) of unit directions (..., 3)."""
    # The normal bisects the direction and the view +Z. From |(d_x, d_y)| near -Z, where 1 + d_z cancels.
    d_x, d_y, d_z = directions.unbind(-1)
    sine = torch.hypot(d_x, d_y)
    radius = torch.sin(torch.atan2(sine, d_z) / 2)
    return directions[..., :2] * (radius / sine.clamp_min(1e-12))[..., None]


LAYOUT = DiscLayout(coordinates, solid_angle=torch.ones_like, edge=math.sqrt(0.5))
"""Pixels that a photographed silhouette cuts hold background."""
