"""Products of vectors with their components apart: the same bits however many vectors there are."""

import torch
from torch import Tensor

Components = Tensor | list[Tensor]
"""(3, ...), or three times (...)."""


def dot(a: Components, b: Components) -> Tensor:
    """(...): of vectors whose components are broadcast."""
    return (a[0] * b[0]).addcmul_(a[1], b[1]).addcmul_(a[2], b[2])


def cross(a: Tensor, b: Tensor) -> list[Tensor]:
    """Three times (...): a x b, of vectors (3, ...)."""
    return [torch.addcmul(a[i] * b[j], a[j], b[i], value=-1) for i, j in ((1, 2), (2, 0), (0, 1))]
