"""Rotations as vectors along their axis, as long as their angle in radians."""

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
