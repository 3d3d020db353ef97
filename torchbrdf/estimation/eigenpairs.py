"""Eigenvalues and eigenvectors of many symmetric matrices at once."""

import torch
from torch import Tensor

from torchbrdf.threads import side_by_side


def eigh(matrices: Tensor) -> tuple[Tensor, Tensor]:
    """`torch.linalg.eigh` of (..., n, n): torch takes one after the other, and two threads gain little on each."""
    count = torch.get_num_threads()
    if matrices.is_cuda or matrices.ndim < 3 or count < 2:
        return torch.linalg.eigh(matrices)
    parts = matrices.flatten(0, -3).tensor_split(count)
    values, vectors = (torch.cat(found) for found in zip(*side_by_side(torch.linalg.eigh, parts), strict=True))
    return values.view(matrices.shape[:-1]), vectors.view(matrices.shape)
