"""What the energy constraint needs of a library: where a combination falls below zero, and directional albedo."""

from dataclasses import dataclass, replace
from math import pi

import torch
from torch import Tensor

from torchbrdf.brdf import (
    GRID,
    N_CELLS,
    ROW_CELLS,
    MaterialLibrary,
    StoredColumns,
    above_horizon,
    albedo_rule,
    unpacked,
)

_STEPS = (2, 3, 6)
"""Every so many cells in theta_h, theta_d, phi_d are looked at first."""

_FINE = (1, 2, 20)
"""Cells of a bin in theta_h, theta_d, phi_d: `scan` names the worst of each, for neighbours say much the same."""

_KEEP = 500
"""Cells that `scan` names for one photograph and channel at most."""


@dataclass(frozen=True, eq=False)
class EnergyBounds:
    """What "energy" needs of a library, computed once (one pass over its columns, a few seconds).

    stored   the columns, all of them, as the library holds them
    columns  (c,) int64       which of them the weights belong to
    usable   (N_CELLS,) bool  above the horizon and measured in some material
    cells    (k,) int64       the thinned cells that are looked at first
    thinned  (k, c) float32   f_r in these cells
    albedo   (a, c) float64   directional albedo of each column at view angles: midpoints of equal parts of [0, pi/2]
    """

    stored: StoredColumns
    columns: Tensor
    usable: Tensor
    cells: Tensor
    thinned: Tensor
    albedo: Tensor

    @classmethod
    def of(cls, library: MaterialLibrary, view_angles: int = 30) -> "EnergyBounds":
        """The bounds of a library; view_angles = 0 leaves out the bound of the albedo.

        Raises ValueError for a negative number of angles.
        """
        if view_angles < 0:
            raise ValueError(f"view_angles must be at least 0, got {view_angles}")
        stored, columns = library.stored, library.column_index
        device = stored.columns.device
        measured = torch.zeros(N_CELLS // 8, dtype=torch.uint8)
        for material in library.materials:
            measured |= stored.valid[material].cpu()
        usable = unpacked(measured).reshape(GRID) & above_horizon()
        coarse = torch.zeros(GRID, dtype=torch.bool)
        coarse[:: _STEPS[0], :: _STEPS[1], :: _STEPS[2]] = True
        cells = torch.nonzero((coarse & usable).ravel()).ravel().to(device)
        angles = (torch.arange(view_angles, dtype=torch.float64) + 0.5) * (pi / 2 / max(view_angles, 1))
        none = torch.empty(0)
        bounds = cls(stored, columns.to(device), usable.ravel().to(device), cells, thinned=none, albedo=none)
        return replace(bounds, thinned=bounds.rows(cells).float(), albedo=bounds._integrate(angles))

    def __repr__(self) -> str:
        """Sizes."""
        return f"EnergyBounds({len(self.columns)} columns, {int(self.usable.sum())} cells, {len(self.albedo)} angles)"

    def select(self, members: Tensor) -> "EnergyBounds":
        """The bounds for weights of some of the columns, by their positions (a class, say)."""
        members = members.to(self.columns.device)
        return replace(
            self, columns=self.columns[members], thinned=self.thinned[:, members], albedo=self.albedo[:, members]
        )

    def rows(self, cells: Tensor) -> Tensor:
        """(len(cells), c) float64: f_r of the columns in cells of the grid."""
        return self.stored.columns[cells][:, self.columns].double() * self._scale

    @property
    def _scale(self) -> Tensor:
        return self.stored.scale.to(self.columns.device)[self.columns]

    def scan(self, weights: Tensor, threshold: float) -> tuple[Tensor, Tensor]:
        """The largest -(B w) / (B |w|) of all usable cells, (N,), and the cells (k,) where it is worst.

        weights    (N, c)
        threshold  cells less deep than this are not named
        In float32, exact to about 1e-7. A cell that no column reaches counts as 0.
        """
        n, stored = len(weights), self.stored.columns
        scaled = (torch.cat([weights, weights.abs()]).mT * self._scale[:, None]).float()
        whole = len(self.columns) > stored.shape[1] // 4
        if whole:
            scaled = scaled.new_zeros(stored.shape[1], 2 * n).index_add_(0, self.columns, scaled)
        corner = torch.arange(ROW_CELLS // (_FINE[1] * _FINE[2]), device=scaled.device)[:, None]
        values, cells = [], []
        for first in range(0, N_CELLS, ROW_CELLS):
            block = stored[first : first + ROW_CELLS]
            product = (block if whole else block[:, self.columns]).float() @ scaled
            depth = torch.where(self.usable[first : first + ROW_CELLS, None], depth_below_zero(product, n), 0.0)
            binned = depth.reshape(GRID[1] // _FINE[1], _FINE[1], GRID[2] // _FINE[2], _FINE[2], n)
            binned = binned.transpose(1, 2).reshape(-1, _FINE[1] * _FINE[2], n)
            value, inside = binned.max(1)
            d = corner // (GRID[2] // _FINE[2]) * _FINE[1] + inside // _FINE[2]
            p = corner % (GRID[2] // _FINE[2]) * _FINE[2] + inside % _FINE[2]
            values.append(value)
            cells.append(first + d * GRID[2] + p)
        value, cell = torch.cat(values), torch.cat(cells)
        worst, position = value.topk(_KEEP, dim=0)
        return worst[0].double(), torch.unique(cell.gather(0, position)[worst > threshold])

    def _integrate(self, angles: Tensor) -> Tensor:
        rules = [albedo_rule(float(angle)) for angle in angles]
        albedo = torch.zeros(len(rules), len(self.columns), dtype=torch.float64, device=self.columns.device)
        edges = torch.arange(GRID[0] + 1) * ROW_CELLS
        slices = [torch.searchsorted(cells, edges).tolist() for cells, _ in rules]
        for i in range(GRID[0] if rules else 0):
            weights = torch.zeros(len(rules), ROW_CELLS, dtype=torch.float64)
            for k, (cells, weight) in enumerate(rules):
                inside = slice(slices[k][i], slices[k][i + 1])
                weights[k, cells[inside] - i * ROW_CELLS] = weight[inside]
            block = self.stored.columns[i * ROW_CELLS : (i + 1) * ROW_CELLS]
            touched = torch.nonzero(weights.any(0)).ravel().to(block.device)
            columns = block[touched][:, self.columns].double()
            albedo += weights.to(block.device)[:, touched] @ columns
        return albedo * self._scale


def depth_below_zero(product: Tensor, n: int) -> Tensor:
    """-(B w) / (B |w|) of products (cells, 2 n) with [w, |w|], 0 where both are 0."""
    value, terms = product[:, :n], product[:, n:]
    return torch.where(terms > 0, -value / torch.where(terms > 0, terms, 1.0), 0.0)
