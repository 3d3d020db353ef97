"""Rotations of light: checked matrices, and vectors along the axis, as long as the angle in radians."""

import numpy as np
import torch
from torch import Tensor


def rotation_of(vector: Tensor) -> Tensor:
    """(3, 3) float64: the rotation about `vector` (3,) by its length in radians, counterclockwise seen from its tip."""
    from scipy.spatial.transform import Rotation  # here, because it is slow to import

    return torch.from_numpy(Rotation.from_rotvec(vector.detach().cpu().numpy()).as_matrix())


def rotation_vector(rotation: Tensor) -> Tensor:
    """(3,) float64: the vector of a rotation (3, 3), no longer than pi."""
    from scipy.spatial.transform import Rotation

    return torch.from_numpy(Rotation.from_matrix(rotation.detach().cpu().double().numpy()).as_rotvec())


def rotation_angle(rotation: Tensor) -> float:
    """Radians, from 0 to pi, by which a rotation (3, 3) turns."""
    return float(rotation_vector(rotation).norm())


def checked_rotation(rotation: Tensor | np.ndarray) -> Tensor:
    """The rotation (3, 3) as float64 on the CPU, without gradients. Raises ValueError for any other matrix."""
    matrix = torch.as_tensor(rotation).detach().to("cpu", torch.float64)
    if matrix.shape != (3, 3):
        raise ValueError(f"rotation must be (3, 3), got {tuple(matrix.shape)}")
    error = float((matrix @ matrix.t() - torch.eye(3, dtype=torch.float64)).abs().max())
    determinant = float(torch.linalg.det(matrix))
    if not (error < 1e-4 and determinant > 0):
        raise ValueError("rotation must be orthonormal with determinant +1, got determinant "
                         f"{determinant:.4g} and |R R^T - 1| up to {error:.2g}")
    return matrix
