"""Priors of neighbourhoods: materials that look alike under this light, a mixture over the manifold of materials."""

import torch
from torch import Tensor

from torchbrdf.estimation.image_space import ImageSpace

NEIGHBOURHOODS = 10
"""Neighbourhoods at most: those around materials that are farthest from all before."""

REACHES = (0.2, 0.4)
"""Radians between weighted basis images over which neighbourhoods fade, each of their centres has one of either."""

_ALIKE = 0.02
"""Radians: a material nearer than this to a centre needs no neighbourhood of its own."""


def image_angles(space: ImageSpace) -> Tensor:
    """(n, n) radians between weighted basis images, mean over the channels of the light that are not black."""
    size = space.energy.sqrt()
    unit = space.white / torch.where(size > 0, size, 1)[:, None]
    lit = (size > 0).any(-1)
    angles = torch.acos((unit.mT @ unit).clamp(-1, 1)) * lit[:, None, None]
    return angles.sum(0) / lit.sum().clamp_min(1)


def farthest_points(distances: Tensor, count: int, nearest: float) -> list[int]:
    """Indices of points, each the farthest from those before, the first in the middle; none nearer than `nearest`."""
    chosen = [int(distances.mean(1).argmin())]
    while len(chosen) < count:
        gap = distances[:, chosen].amin(1)
        if not float(gap.max()) > nearest:
            break
        chosen.append(int(gap.argmax()))
    return chosen


def neighbourhood_variances(space: ImageSpace, whole: Tensor) -> Tensor:
    """S (N, n) of neighbourhoods, one a reach and centre, from which the variances (n,) of the whole library fade."""
    angles = image_angles(space)
    centres = farthest_points(angles, NEIGHBOURHOODS, _ALIKE)
    return torch.cat([torch.exp(-((angles[centres] / reach) ** 2)) for reach in REACHES]) * whole
