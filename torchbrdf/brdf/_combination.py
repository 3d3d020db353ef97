"""Combinations of a library's columns, B w: a pass over all cells that converts and multiplies a block at a time."""

import torch
from torch import Tensor
from torch.nn.functional import conv2d

from torchbrdf.brdf.merl_grid import GRID, N_CELLS
from torchbrdf.brdf.stored_columns import ROW_CELLS, StoredColumns
from torchbrdf.lasting import without_autocast

_BLOCK_CELLS = ROW_CELLS // 2
"""Rows of a block: with 300 columns it is 10 MB in float32, which a processor's cache holds."""

_SPARSE = 16
"""Where fewer than one column in so many has a weight, those are gathered; else converting all of them is faster."""


@without_autocast
def combined(stored: StoredColumns, columns: Tensor, weights: Tensor, keep: bool = True) -> list[Tensor]:
    """K times B w (N_CELLS, 3) float32 on the CPU, what is below zero set to zero.

    columns  (c,)       of those stored
    weights  (K, c, 3)  float64
    keep     see `StoredColumns.blocks`
    """
    if not len(columns):
        return [torch.zeros(N_CELLS, 3, dtype=torch.float32) for _ in weights]
    device, n = stored.columns.device, stored.columns.shape[1]
    scaled = (weights * stored.scale[columns, None]).permute(0, 2, 1).flatten(0, 1)
    gathered = _SPARSE * len(columns) < n
    if not gathered:
        scaled = scaled.new_zeros(len(scaled), n).index_add_(1, columns, scaled)
    scaled = scaled.to(device, torch.float32)
    values = [torch.empty(N_CELLS, 3, dtype=torch.float32) for _ in weights]
    buffer = torch.empty(_BLOCK_CELLS, scaled.shape[1], dtype=torch.float32, device=device)
    for start, rows in stored.blocks(_BLOCK_CELLS, keep):
        buffer.copy_(rows[:, columns] if gathered else rows)
        product = _product(buffer, scaled).clamp_min_(0).cpu()
        for value, part in zip(values, product.split(3, dim=1), strict=True):
            value[start : start + _BLOCK_CELLS] = part
    return values


def _product(rows: Tensor, weights: Tensor) -> Tensor:
    """(N, m) of rows (N, n) and weights (m, n).

    On the CPU as a convolution of a picture, channels last, with single pixels: a matrix product packs all rows for a
    few columns of weights, and takes three times as long.
    """
    if rows.is_cuda:
        return rows @ weights.mT
    picture = rows.view(1, -1, GRID[1], rows.shape[1]).permute(0, 3, 1, 2)
    return conv2d(picture, weights[:, :, None, None]).permute(0, 2, 3, 1).reshape(len(rows), -1)
