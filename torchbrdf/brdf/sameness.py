"""Which materials of a library are one measurement under two names."""

import torch
from torch import Tensor

from torchbrdf.brdf.merl_grid import above_horizon

SAME = 0.04
"""Sine of the angle between the square roots of two tables, as vectors, up to which they are one measurement.

MERL's materials in the embedded library and decoded from neural encodings: at most 0.012. The two of them that are most
alike: 0.062. A sharp material that was saved in the other format may differ by more.
"""

_CELLS = 4096
_LEAST_SHARED = 0.3
"""Of those, without which nothing is said."""


def sampled_cells() -> Tensor:
    """(4096,) int64: cells above the horizon in which tables are compared."""
    lit = torch.nonzero(above_horizon().ravel()).ravel()
    return lit[torch.arange(_CELLS) * len(lit) // _CELLS]


def same_measurements(values: Tensor, measured: Tensor) -> list[tuple[int, int]]:
    """Pairs (i, j), i < j, of materials that are equal but for one factor, within `SAME`, where both were measured.

    values    (4096, 3 m)  f_r in `sampled_cells`
    measured  (m, 4096)    bool
    """
    weight = measured.double().repeat(1, 3)
    roots = torch.stack([table.T.ravel() for table in values.double().clamp_min(0).sqrt().split(3, dim=1)]) * weight
    squares = roots.square() @ weight.T
    cosine = roots @ roots.T / (squares * squares.T).clamp_min(torch.finfo(torch.float64).tiny).sqrt()
    close = (cosine > (1 - SAME**2) ** 0.5) & (weight @ weight.T > _LEAST_SHARED * weight.shape[1])
    return [(i, j) for i, j in torch.nonzero(close.triu(1)).tolist()]
