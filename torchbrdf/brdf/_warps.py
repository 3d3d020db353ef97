"""Maps of the unit square onto itself that spread a density evenly, as RGL's files use them [DJ18].

A density is given at the nodes of a grid, bilinear between, for each of several parameters, linear between. The row
follows from the marginal distribution, the column from the conditional one of that row: a point of density becomes the
share of the density above it, and of that left of it in its row.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor


class Between(NamedTuple):
    """Between which two of several parameters each value lies: the lower's index (n,), and the upper's share (n,)."""

    lower: Tensor
    share: Tensor

    @classmethod
    def of(cls, values: Tensor, nodes: Tensor) -> "Between":
        """Of values (n,) between increasing nodes; beyond them, the last."""
        if len(nodes) == 1:
            return cls(torch.zeros_like(values, dtype=torch.long), torch.zeros_like(values))
        lower = (torch.searchsorted(nodes, values) - 1).clamp_(0, len(nodes) - 2)
        return cls(lower, ((values - nodes[lower]) / (nodes[lower + 1] - nodes[lower])).clamp_(0, 1))


def in_patches(position: Tensor, nodes: int) -> tuple[Tensor, Tensor]:
    """Positions in [0, 1] as the patch between nodes and the place in it, 0 to 1."""
    scaled = position.clamp(0, 1) * (nodes - 1)
    patch = scaled.long().clamp_(max=nodes - 2)
    return patch, scaled - patch


@dataclass(frozen=True)
class Grids:
    """Values at the nodes of a grid, bilinear between, for each of several parameters, linear between.

    corners  (t (h - 1) (w - 1), 4 c)  the c values of each patch at its four corners: left and right of both rows
    size     (h, w)
    """

    corners: Tensor
    size: tuple[int, int]

    @classmethod
    def of(cls, values: np.ndarray) -> "Grids":
        """Of values (t, c, h, w)."""
        spread = np.moveaxis(values, 1, -1)
        around = (spread[:, :-1, :-1], spread[:, :-1, 1:], spread[:, 1:, :-1], spread[:, 1:, 1:])
        packed = np.concatenate(around, -1).reshape(-1, 4 * values.shape[1])
        return cls(torch.from_numpy(np.ascontiguousarray(packed, np.float32)), (values.shape[2], values.shape[3]))

    def at(self, x: Tensor, y: Tensor, between: Between) -> Tensor:
        """(n, c) values at columns x and rows y in [0, 1]."""
        h, w = self.size
        (column, right), (row, down) = in_patches(x, w), in_patches(y, h)
        first = (between.lower * (h - 1) + row) * (w - 1) + column
        found = _mixed(self.corners, first, (h - 1) * (w - 1), between.share)
        weights = torch.stack([(1 - right) * (1 - down), right * (1 - down), (1 - right) * down, right * down], 1)
        return (found.view(len(x), 4, -1) * weights[:, :, None]).sum(1)


@dataclass(frozen=True)
class Warps:
    """Densities on a grid, as maps of the unit square.

    patches  (t (h - 1) (w - 1), 9)  of each patch: the density at its corners, the integral of its upper and lower row
             left of it and of those rows as a whole, and the integral of all rows above; the whole integral is 1
    """

    patches: Tensor
    size: tuple[int, int]

    @classmethod
    def of(cls, density: np.ndarray) -> "Warps":
        """Of a density (t, h, w) >= 0 at the nodes."""
        density = density.astype(np.float64)
        count, h, w = density.shape
        left = np.zeros((count, h, w))
        left[..., 1:] = np.cumsum((density[..., 1:] + density[..., :-1]) * (0.5 / (w - 1)), -1)
        rows = left[..., -1]
        above = np.zeros((count, h))
        above[:, 1:] = np.cumsum((rows[:, 1:] + rows[:, :-1]) * (0.5 / (h - 1)), -1)
        whole = above[:, -1, None, None]
        d, s, r = density / whole, left / whole, np.broadcast_to(rows[..., None] / whole, density.shape)
        a = np.broadcast_to(above[..., None] / whole, density.shape)
        upper, lower = np.s_[:, :-1, :-1], np.s_[:, 1:, :-1]
        kept = (d[upper], d[:, :-1, 1:], d[lower], d[:, 1:, 1:], s[upper], s[lower], r[upper], r[lower], a[upper])
        packed = np.stack(kept, -1).reshape(-1, len(kept))
        return cls(torch.from_numpy(packed.astype(np.float32)), (h, w))

    def flattened(self, x: Tensor, y: Tensor, between: Between) -> tuple[Tensor, Tensor]:
        """Where points go: the columns and rows, each (n,) in [0, 1], of positions at columns x and rows y."""
        h, w = self.size
        (column, right), (row, down) = in_patches(x, w), in_patches(y, h)
        first = (between.lower * (h - 1) + row) * (w - 1) + column
        found = _mixed(self.patches, first, (h - 1) * (w - 1), between.share)
        d00, d10, d01, d11, left0, left1, row0, row1, above = found.unbind(1)
        c0, c1 = torch.lerp(d00, d01, down), torch.lerp(d10, d11, down)
        across = torch.lerp(left0, left1, down) + _integral(right, c0, c1) / (w - 1)
        new_x = across / torch.lerp(row0, row1, down)
        return torch.nan_to_num(new_x), above + _integral(down, row0, row1) / (h - 1)


def _integral(to: Tensor, first: Tensor, last: Tensor) -> Tensor:
    """From 0 to a place in [0, 1] of what goes linearly from `first` to `last`."""
    return to * torch.lerp(first, last, 0.5 * to)


def _mixed(rows: Tensor, first: Tensor, stride: int, share: Tensor) -> Tensor:
    """Rows of a table at `first`, mixed with those a stride further."""
    found = rows.index_select(0, first)
    if len(rows) == stride:
        return found
    return found.lerp_(rows.index_select(0, first + stride), share[:, None])
