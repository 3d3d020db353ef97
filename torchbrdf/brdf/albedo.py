"""How much of the light a BRDF reflects."""

from collections.abc import Callable
from functools import lru_cache
from math import pi, radians

import torch
from torch import Tensor

from torchbrdf.brdf.directions import half_difference
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.brdf.merl_grid import cell_index, row_edges
from torchbrdf.lasting import lasting

ALBEDO_DEG = (0, 30, 60, 75)

MUCH_ALBEDO = 1.02
"""Directional albedo above which a page says so: the rule of cells is good to a per cent."""

WRONG_ALBEDO = 2.0
"""Which no extrapolation to grazing angles explains, but another unit does: a factor of pi, 255 or 1500."""

_AT_ONCE = 1 << 12
"""Cells: of a library of 500 materials 50 MB."""


def directional_albedo(table: MerlTable) -> Tensor:
    """(4, 3) float64: the share of light from `ALBEDO_DEG` that is reflected in R, G, B."""
    return albedo_of(table.filled.cpu().__getitem__)


def albedo_of(rows: Callable[[Tensor], Tensor]) -> Tensor:
    """(4, n) float64: the share of light from `ALBEDO_DEG` that is reflected by n BRDFs.

    rows  f_r (r, n) in cells (r,)
    """
    return torch.stack([_integral(rows, *rule) for rule in _rules()])


def _integral(rows: Callable[[Tensor], Tensor], cells: Tensor, weights: Tensor) -> Tensor:
    parts = zip(cells.split(_AT_ONCE), weights.split(_AT_ONCE), strict=True)
    return torch.stack([some @ rows(where).double() for where, some in parts]).sum(0)


@lru_cache(maxsize=1)
@lasting
def _rules() -> list[tuple[Tensor, Tensor]]:
    return [albedo_rule(radians(angle)) for angle in ALBEDO_DEG]


def reflects_too_much(albedo: Tensor, much: float = MUCH_ALBEDO) -> str | None:
    """What to say of a directional albedo (4, ...) above `much`; None where it is none."""
    if not albedo.max() > much:
        return None
    worst = int(albedo.reshape(len(ALBEDO_DEG), -1).amax(1).argmax())
    most = float(albedo.max())
    return f"reflects {most:{'.2f' if most < 1000 else '.1e'}} times the light that comes in at {ALBEDO_DEG[worst]}°"


def albedo_rule(view_angle: float, steps_h: int = 3, steps_phi: int = 360) -> tuple[Tensor, Tensor]:
    """Ascending cells (r,) and weights (r,) of a rule for the directional albedo: a = sum weights f_r[cells].

    a(w_o) = integral f_r cos(theta_i) dw_i over the hemisphere, taken over half vectors (dw_i = 4 cos(theta_d) dw_h):
    there a peak at any view angle lies at theta_h = 0, where the cells are narrow. Each row of cells in theta_h is
    cut into steps_h rings and each ring into steps_phi sectors; a ring's solid angle is exact. The weights of a
    Lambertian surface sum to pi; what the horizon's edge leaves missing (about 1e-4) is made up by one factor.

    view_angle  radians, from 0 to less than pi / 2
    """
    edges = row_edges(steps_h)
    theta = ((edges[1:] + edges[:-1]) / 2)[:, None]
    solid = (torch.cos(edges[:-1]) - torch.cos(edges[1:]))[:, None] * (2 * pi / steps_phi)
    phi = (torch.arange(steps_phi, dtype=torch.float64) + 0.5) * (2 * pi / steps_phi)
    sin_h = torch.sin(theta)
    h = torch.stack([sin_h * torch.cos(phi), sin_h * torch.sin(phi), torch.cos(theta).expand(-1, steps_phi)], dim=-1)
    angle = torch.tensor(view_angle, dtype=torch.float64)
    w_o = torch.stack([torch.sin(angle), torch.zeros_like(angle), torch.cos(angle)])
    cos_d = (h @ w_o)[..., None]
    w_i = 2 * cos_d * h - w_o
    seen = (cos_d[..., 0] > 0) & (w_i[..., 2] > 0)
    weights = (4 * cos_d[..., 0] * w_i[..., 2] * solid)[seen]
    cells = cell_index(*half_difference(w_i[seen], w_o.expand_as(w_i[seen]))).long()
    cells, inverse = torch.unique(cells, return_inverse=True)
    weights = torch.zeros(len(cells), dtype=torch.float64).index_add_(0, inverse, weights)
    return cells, weights * (pi / weights.sum())
