"""A measured material of the RGL database on MERL's grid: what its cells reflect, and which of them were measured.

The database measured each pair of directions twice, from either side, and the two differ (by a tenth and more in some
files, where a surface was a little tilted or light got lost); a table has one value for both, their mean. Where one of
them is f_r cos(theta_o) of a grazing direction, divided by next to nothing, it counts for less.

A cell of negative luminance is no colour: files go on below the horizon, some with values below 0 (`rgl_writing`), and
interpolation across it takes from these. No such cell was measured.
"""

from dataclasses import dataclass
from math import pi

import torch
from torch import Tensor

from torchbrdf.brdf.merl_grid import GRID, above_horizon, cell_centres
from torchbrdf.brdf.rgl import RGLMaterial
from torchbrdf.images import luminance

TABULATION = 2
"""Changes whenever `tabulate` gives other tables: caches of libraries know by it what is out of date."""

_ROWS = 2
"""Of theta_h at once: some 10^5 pairs of directions, 30 MB."""

_MEASURED = 0.5
"""Of the weight of what an interpolated value is made of, for it to count as measured."""

_LEAST_COSINE = 1e-3

_GRAZING = 0.15
"""In cos(theta_o), below which a measurement counts for less, by the square of its cosine."""

_FINE_ROWS, _FINE_PARTS = 16, 4
"""Rows of theta_h, up to 2.8 degrees, in which lobes are sharper than a cell, and into how many parts these are cut.

With 6 parts, or with 2 x 2 of theta_d and phi_d besides, pictures change by 0.1 % or less. Beyond, one is enough."""


@dataclass(frozen=True)
class Tabulated:
    """A material on the grid.

    values    (90, 90, 180, 3) float32  f_r in 1/sr, 0 where not valid
    valid     (90, 90, 180) bool
    negative  share of the valid cells of which a channel was negative, and not the luminance, a colour that Rec. 709
              does not have: now 0
    clipped   relative RMS, over the valid cells, of what that took from f_r
    spread    of an anisotropic material: relative RMS of f_r cos(theta_o) over the azimuths averaged; else 0
    """

    values: Tensor
    valid: Tensor
    negative: float
    clipped: float
    spread: float


def tabulate(material: RGLMaterial) -> Tabulated:
    """Every cell of the grid: f_r averaged over the cell, both ways, and over all azimuths of w_i."""
    values, valid = torch.zeros(*GRID, 3, dtype=torch.float32), above_horizon().clone()
    negative, clipped, squares = 0, torch.zeros(2, dtype=torch.float64), torch.zeros(2, dtype=torch.float64)
    for first in range(0, GRID[0], _ROWS):
        rows = slice(first, first + _ROWS)
        inside = valid[rows].clone()
        found, measured, spread = _cells(material, rows, inside)
        squares += spread
        measured &= (found >= 0).all(-1) | (luminance(found.T) > 0)
        found = found[measured]
        negative += int((found < 0).any(-1).sum())
        clipped += torch.stack([found.clamp_max(0).square().sum(), found.square().sum()])
        inside[inside.clone()] = measured
        valid[rows] = inside
        values[rows][inside] = found.clamp_min(0)
    share = negative / max(1, int(valid.sum()))
    return Tabulated(values, valid, share, _root_of_ratio(clipped), _root_of_ratio(squares))


def _root_of_ratio(squares: Tensor) -> float:
    return float((squares[0] / squares[1].clamp_min(1e-30)).sqrt())


def _cells(material: RGLMaterial, rows: slice, inside: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """f_r (n, 3) of the cells of some rows that are inside, which were measured (n,), and the squares of `spread`."""
    count = int(inside.sum())
    total, weight = (torch.zeros(count, *last, dtype=torch.float32) for last in ((3,), ()))
    squares = torch.zeros(2, dtype=torch.float64)
    parts = _FINE_PARTS if rows.start < _FINE_ROWS else 1
    for part in range(parts):
        theta_h, theta_d, phi_d = (a[inside] for a in _places(rows, (part + 0.5) / parts, inside.shape))
        sin_h, cos_h, sin_d, cos_d = theta_h.sin(), theta_h.cos(), theta_d.sin(), theta_d.cos()
        along, across = sin_d * phi_d.cos(), sin_d * phi_d.sin()
        for sign in (1, -1):
            z_i, z_o = cos_d * cos_h - sign * along * sin_h, cos_d * cos_h + sign * along * sin_h
            x_i = cos_d * sin_h + sign * along * cos_h
            y_i = sign * across
            theta_i, azimuth = torch.atan2(torch.hypot(x_i, y_i), z_i), -torch.atan2(y_i, x_i)
            mean, sure, spread = _over_azimuths(material, theta_i, theta_h, azimuth)
            sure = sure * ((z_i > _LEAST_COSINE) & (z_o > _LEAST_COSINE) & (theta_i <= material.last_measured))
            z_o = z_o.clamp_min(_LEAST_COSINE)
            squares += spread
            sure = sure * (z_o / _GRAZING).clamp_max(1).square()
            total = total + mean * (sure / z_o)[:, None]
            weight = weight + sure
    return total / weight.clamp_min(1e-20)[:, None], weight > 0, squares


def _over_azimuths(
    material: RGLMaterial, theta_i: Tensor, theta_m: Tensor, azimuth: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """f_r cos(theta_o) (n, 3), which was measured (n,), and the squares of its deviations and of itself (2,)."""
    if material.isotropic:
        found, measured = material.cos_weighted(theta_i, theta_m, azimuth)
        return found, (measured >= _MEASURED).float(), torch.zeros(2, dtype=torch.float64)
    total, weight = (torch.zeros(len(theta_i), width, dtype=torch.float32) for width in (3, 1))
    squares = torch.zeros(len(theta_i), 3, dtype=torch.float32)
    for phi, share in enumerate(material.azimuth_weights):
        for turned in (azimuth, -azimuth) if material.mirrored else (azimuth,):
            found, measured = material.cos_weighted(theta_i, theta_m, turned, phi)
            sure = share * (measured >= _MEASURED).float()[:, None]
            total, weight, squares = total + sure * found, weight + sure, squares + sure * found.square()
    mean = total / weight.clamp_min(1e-20)
    deviations = (squares / weight.clamp_min(1e-20) - mean.square()).clamp_min(0)
    return mean, (weight[:, 0] > 0).float(), torch.stack([deviations.sum(), mean.square().sum()]).double()


def _places(rows: slice, share: float, shape: torch.Size) -> tuple[Tensor, ...]:
    """theta_h, theta_d, phi_d, in the shape, in the cells of some rows; that share of a row has less theta_h.

    The middle of a row's solid angle is not the middle of its theta_h: three quarters of the first row's lie beyond.
    """
    edges = torch.sin((torch.arange(rows.start, rows.stop + 1, dtype=torch.float64) / GRID[0]) ** 2 * (pi / 4)).square()
    theta_h = 2 * torch.asin(torch.lerp(edges[:-1], edges[1:], share).sqrt()).float()
    _, theta_d, phi_d = cell_centres(torch.float32)
    return theta_h[:, None, None].expand(shape), theta_d.expand(shape), phi_d.expand(shape)
