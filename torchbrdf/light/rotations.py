"""Rotations of light: checked matrices, and vectors along the axis, as long as the angle in radians."""

import numpy as np
import torch
from torch import Tensor

_NEARLY_NONE = 1e-3
"""Below this sine of half the angle a series is exact to rounding, and has derivatives at 0."""


def rotation_of(vector: Tensor) -> Tensor:
    """(3, 3) float64 on the CPU: the rotation about a vector by its length, counterclockwise seen from its tip.

    vector   (3,) in radians
    returns  the exponential of the vector's cross product, differentiable
    Raises ValueError for other shapes.
    """
    if vector.shape != (3,):
        raise ValueError(f"a rotation vector must be (3,), got {tuple(vector.shape)}")
    x, y, z = vector.to("cpu", torch.float64).unbind()
    o = torch.zeros_like(x)
    return torch.linalg.matrix_exp(torch.stack([o, -z, y, z, o, -x, -y, x, o]).view(3, 3))


def rotation_vector(rotation: Tensor) -> Tensor:
    """(3,) float64 on the CPU: the vector of a rotation (3, 3), no longer than pi.

    Differentiable; at half a turn, where the vector jumps to its opposite, from one side.
    Raises ValueError where rotation is none.
    """
    checked_rotation(rotation)
    r = rotation.to("cpu", torch.float64)
    trace = r.trace()
    diagonal = torch.diagonal(r).detach()
    i = int(diagonal.argmax())
    # A quaternion times its largest component, which no rounding touches
    if bool(trace >= diagonal[i]):
        along, w = torch.stack([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]), 1 + trace
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        mixed = r[i] + r[:, i]
        along = torch.where(torch.arange(3) == i, 1 - trace + mixed, mixed)
        w = r[k, j] - r[j, k]
    length = torch.sqrt(along.square().sum() + w.square())
    sign = -1 if bool(w < 0) else 1
    along, w = sign * along / length, sign * w / length
    squared = along.square().sum()
    if bool(squared < _NEARLY_NONE**2):
        tangent = squared / w.square()
        return along * (2 - tangent * (2 / 3 - tangent * (2 / 5))) / w
    sine = squared.sqrt()
    return along * (2 * torch.atan2(sine, w) / sine)


def rotation_angle(rotation: Tensor) -> float:
    """Radians, from 0 to pi, by which a rotation (3, 3) turns."""
    return float(rotation_vector(rotation.detach()).norm())


def checked_rotation(rotation: Tensor | np.ndarray) -> Tensor:
    """The rotation (3, 3) as float64 on the CPU, without gradients. Raises ValueError for any other matrix."""
    matrix = torch.as_tensor(rotation).detach().to("cpu", torch.float64)
    if matrix.shape != (3, 3):
        raise ValueError(f"rotation must be (3, 3), got {tuple(matrix.shape)}")
    error = float((matrix @ matrix.t() - torch.eye(3, dtype=torch.float64)).abs().max())
    determinant = float(torch.linalg.det(matrix))
    if not (error < 1e-4 and determinant > 0):
        raise ValueError(
            "rotation must be orthonormal with determinant +1, got determinant "
            f"{determinant:.4g} and |R R^T - 1| up to {error:.2g}"
        )
    return matrix
