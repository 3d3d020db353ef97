"""How far an analytic BRDF is from a table in some cells of the MERL grid, in a metric."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import cos, radians

import torch
from torch import Tensor

from torchbrdf.analytic.shading_geometry import ShadingGeometry
from torchbrdf.brdf import GRID, METRICS, N_CELLS, MerlTable, cell_centres, cell_measure, incident_cosine
from torchbrdf.lasting import lasting

MODEL_ERROR = 0.1
"""What an analytic model misses of a material anyway: an uncertainty of this share halves the weight of a cell."""

_SHIFTS = (5, 8)
"""Cells of phi_d by which the next row and column of chosen cells are shifted."""

_DARKEST = 1e-6
"""In 1/sr: cells darker than this have no relative uncertainty."""

Uncertainty = Callable[[Tensor], Tensor]
"""Standard deviation of f_r (C, 3) in 1/sr in cells of flat indices (C,)."""


@dataclass(frozen=True)
class FitCells:
    """Cells of the MERL grid that a fit looks at.

    index     (C,)    flat
    geometry  of the pairs of directions at their centres
    cos_i     (C, 1)
    measure   (C, 1)  sr^2
    """

    index: Tensor
    geometry: ShadingGeometry
    cos_i: Tensor
    measure: Tensor


@lru_cache(maxsize=6)
@lasting
def fit_cells(steps: tuple[int, int, int], largest_angle_deg: float, dtype: torch.dtype) -> FitCells:
    """One of so many cells along theta_h, theta_d and phi_d, without those whose directions are beyond an angle.

    Rows and columns are shifted against each other, so that every theta_d and phi_d is looked at in some row.
    """
    inside = incident_cosine() > cos(radians(largest_angle_deg))
    inside &= inside.flip(2)  # the cell of the reversed pair
    h, d, p = (torch.arange(size) for size in GRID)
    row = (h // steps[0])[:, None]
    column = (d + row) // steps[1]
    chosen = ((h % steps[0] == steps[0] // 2)[:, None] & ((d + row) % steps[1] == steps[1] // 2))[..., None]
    chosen = chosen & ((p + _SHIFTS[0] * row[..., None] + _SHIFTS[1] * column[..., None]) % steps[2] == steps[2] // 2)
    index = torch.nonzero((chosen & inside).ravel()).ravel()
    angles = (angle.expand(GRID).reshape(-1)[index] for angle in cell_centres())
    cos_i, measure = (values.ravel()[index, None].to(dtype) for values in (incident_cosine(), cell_measure()))
    return FitCells(index, ShadingGeometry.of_angles(*angles).to(dtype), cos_i, measure)


@dataclass(frozen=True)
class TableResiduals:
    """Residuals whose squares sum to the squared relative error, see `table_fit`.

    values  (C, 3)  g(f_r* cos theta_i)
    roots   (C, 3)  square roots of the weights, divided by the norm of the weighted values
    """

    cells: FitCells
    metric: str
    values: Tensor
    roots: Tensor

    @classmethod
    def of_table(
        cls, table: MerlTable, cells: FitCells, metric: str, uncertainty: Uncertainty | None = None
    ) -> "TableResiduals":
        """From a model to a table; uncertain cells count less."""
        measured = table.valid.ravel().cpu()[cells.index, None]
        f_r = table.values.detach().cpu().reshape(N_CELLS, 3)[cells.index].to(cells.cos_i.dtype)
        f_r = torch.where(measured, f_r, 0).clamp_min(0)
        values = METRICS[metric](f_r * cells.cos_i)
        weights = (cells.measure * measured).expand(-1, 3)
        if uncertainty is not None:
            std = torch.where(measured, uncertainty(cells.index).to(f_r), 0)
            share = std / f_r.clamp_min(_DARKEST)
            weights = weights / (1 + (share / MODEL_ERROR).square())
        return cls(cells, metric, values, (weights / (weights * values.square()).sum()).sqrt())

    @property
    def any_light(self) -> bool:
        """Some cell was measured, is not black and has a weight; else the roots are not finite."""
        return bool(self.roots.isfinite().all())

    @property
    def geometry(self) -> ShadingGeometry:
        """Of the cells."""
        return self.cells.geometry

    def of(self, f_r: Tensor) -> Tensor:
        """(C, 3) of f_r (C, 3)."""
        return self.roots * (METRICS[self.metric](f_r * self.cells.cos_i) - self.values)

    def error(self, f_r: Tensor) -> float:
        """E of f_r (C, 3)."""
        return float(self.of(f_r).double().square().sum().sqrt())

    def along(self, f_r: Tensor, tangents: Tensor) -> Tensor:
        """(S, C, 3): derivatives of `of` at f_r along tangents (S, C, 3)."""
        with torch.enable_grad():
            at = f_r.detach().requires_grad_()
            (slope,) = torch.autograd.grad(self.of(at).sum(), at)  # elementwise, so one slope serves all
        return slope * tangents
