"""Which pixels of a photograph a silhouette covers, by their corners."""

from collections.abc import Callable

import torch
from torch import Tensor

Contains = Callable[[Tensor], Tensor]
"""(..., 2) -> (...) bool: whether places in pixels lie in a silhouette."""


def wholly_inside(contains: Contains, rows: slice, columns: slice) -> Tensor:
    """(h, w) bool: the pixels in these rows and columns whose corners all lie in a silhouette."""
    corners = _corners(contains, rows, columns)
    return corners[1:, 1:] & corners[1:, :-1] & corners[:-1, 1:] & corners[:-1, :-1]


def touched(contains: Contains, rows: slice, columns: slice) -> Tensor:
    """(h, w) bool: those of which a corner does."""
    corners = _corners(contains, rows, columns)
    return corners[1:, 1:] | corners[1:, :-1] | corners[:-1, 1:] | corners[:-1, :-1]


def _corners(contains: Contains, rows: slice, columns: slice) -> Tensor:
    y, x = (torch.arange(side.start, side.stop + 1, dtype=torch.float64) for side in (rows, columns))
    return contains(torch.stack(torch.broadcast_tensors(x, y[:, None]), -1))
