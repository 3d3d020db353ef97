"""What the constraint "lobes" needs of a library: how the highlights of its columns fall off.

A photograph tells a highlight as wide as a pixel or a lamp, not what it is made of: columns a thousand times as bright
within a quarter of a degree may cancel each other there, and leave a spike or a black ring that a point light shows.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.brdf import GRID, MaterialLibrary

_THETA_H = (0, 1, 2, 3, 4, 6, 8, 11, 14, 18)
"""Cells along a highlight, from its middle to 4 degrees: there the squares of a degree are as dense as the grid's."""

_THETA_D = range(0, 90, 15)
"""Cells, of a degree, in which highlights are looked at. Those between follow: columns are smooth in theta_d."""

_PHI_D = GRID[2] // 2
"""The cell across the plane of incidence: above the horizon for all of those."""


@dataclass(frozen=True, eq=False)
class LobeBounds:
    """Highlights that do not rise away from their middle, nor fall below zero: A w >= 0.

    rows  (m, c) float64  A: how much darker each column is in a cell than in the one before it; last, how bright
    """

    rows: Tensor

    @classmethod
    def of(cls, library: MaterialLibrary) -> "LobeBounds":
        """The bounds of a library."""
        h, d = torch.tensor(_THETA_H), torch.tensor(_THETA_D)
        cells = (h * GRID[1] + d[:, None]) * GRID[2] + _PHI_D
        f_r = library.rows(cells.ravel()).double().unflatten(0, cells.shape)
        return cls(torch.cat([f_r[:, :-1] - f_r[:, 1:], f_r[:, -1:]], 1).flatten(0, 1))

    def __repr__(self) -> str:
        """Sizes."""
        return f"LobeBounds({self.rows.shape[1]} columns, {len(self.rows)} rows)"

    def select(self, members: Tensor) -> "LobeBounds":
        """The bounds for weights of some of the columns, by their positions (a class, say)."""
        return LobeBounds(self.rows[:, members.to(self.rows.device)])
