"""Rotations, and how far apart two are."""

from collections.abc import Sequence
from math import asin, degrees, radians, sqrt

import torch
from torch import Tensor


def turn_about(axis: Sequence[float], angle: float) -> Tensor:
    """(3, 3) float64: the rotation about an axis by degrees, as the exponential of what generates it."""
    x, y, z = torch.nn.functional.normalize(torch.tensor(axis, dtype=torch.float64), dim=0).tolist()
    generator = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    return torch.linalg.matrix_exp(radians(angle) * generator)


def degrees_between(one: Tensor, other: Tensor) -> float:
    """The angle of the turn from one rotation to another: |R - Q| = 2 sqrt(2) sin(angle / 2)."""
    distance = float(torch.linalg.matrix_norm(one.double() - other.double()))
    return degrees(2 * asin(min(1.0, distance / sqrt(8))))
