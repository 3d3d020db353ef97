"""Which materials of a library are one measurement under two names."""

from collections.abc import Sequence
from typing import Protocol

import torch
from torch import Tensor

from torchbrdf.brdf.merl_grid import above_horizon

SAME = 0.01
"""Root mean square of the logarithm of the ratio of two tables, after one factor, below which they are one."""

_CELLS = 4096
_FLOOR = 1e-4
"""Of a table's median: what is darker is noise."""


class _Rows(Protocol):
    @property
    def names(self) -> tuple[str, ...]: ...

    def rows(self, cells: Tensor) -> Tensor: ...


def same_measurements(library: _Rows) -> list[tuple[str, str]]:
    """Pairs of materials whose tables are equal but for one factor, within `SAME`."""
    rows = library.rows(shared_sample()).double().cpu()
    return same_values([rows[:, i : i + 3] for i in range(0, rows.shape[1], 3)], library.names)


def shared_sample() -> Tensor:
    """Cells above the horizon in which tables are compared."""
    lit = torch.nonzero(above_horizon().ravel()).ravel()
    return lit[torch.arange(_CELLS) * len(lit) // _CELLS]


def same_values(values: Sequence[Tensor], names: Sequence[str]) -> list[tuple[str, str]]:
    """Pairs of tables, by values (N, 3) in the same cells, that are one measurement."""
    logs = torch.stack([_relative(value).ravel() for value in values])
    centred = logs - logs.mean(1, keepdim=True)
    power = centred.square().mean(1)
    close = (power[:, None] + power - 2 * centred @ centred.T / logs.shape[1]).clamp_min(0) < SAME**2
    return [(names[i], names[j]) for i, j in torch.nonzero(close.triu(1)).tolist()]


def _relative(value: Tensor) -> Tensor:
    return torch.log(value.clamp_min(_FLOOR * float(value.median()) + torch.finfo(torch.float32).tiny))
