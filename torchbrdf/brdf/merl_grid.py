"""The grid of MERL's tables [MPBM03]: theta_h, theta_d, phi_d, theta_h warped by a square root, as [Rus98] has them."""

from functools import lru_cache
from math import pi

import torch
from torch import Tensor

from torchbrdf.lasting import lasting

GRID = (90, 90, 180)
"""Cells in theta_h, theta_d and phi_d, in file order (phi_d fastest)."""

N_CELLS = GRID[0] * GRID[1] * GRID[2]


def cell_centres(dtype: torch.dtype = torch.float64) -> tuple[Tensor, Tensor, Tensor]:
    """theta_h (90, 1, 1), theta_d (90, 1), phi_d (180,) in radians at the centres of the cells."""
    theta_h = ((torch.arange(GRID[0], dtype=dtype) + 0.5) / GRID[0]) ** 2 * (pi / 2)
    theta_d = (torch.arange(GRID[1], dtype=dtype) + 0.5) / GRID[1] * (pi / 2)
    phi_d = (torch.arange(GRID[2], dtype=dtype) + 0.5) / GRID[2] * pi
    return theta_h[:, None, None], theta_d[:, None], phi_d


def row_edges(parts: int = 1) -> Tensor:
    """(90 parts + 1,) float64: theta_h in radians at the edges of the rows, each cut into parts of the warped axis."""
    rows = GRID[0] * parts
    return (torch.arange(rows + 1, dtype=torch.float64) / rows) ** 2 * (pi / 2)


@lru_cache(maxsize=1)
@lasting
def above_horizon() -> Tensor:
    """(90, 90, 180) bool: cells at whose centre both directions lie above the horizon (75 % of them)."""
    theta_h, theta_d, phi_d = cell_centres()
    tilt = torch.sin(theta_d) * torch.cos(phi_d) * torch.sin(theta_h)
    return tilt.abs() < torch.cos(theta_d) * torch.cos(theta_h)  # z of w_i and w_o is the right side -+ the tilt


def measured_share(valid: Tensor) -> float:
    """Of the cells above the horizon the share that (90, 90, 180) bool, or as many in another shape, holds.

    The others no direction reaches: a whole table has 1.
    """
    lit = above_horizon().to(valid.device)
    return int((valid.reshape(GRID) & lit).sum()) / int(lit.sum())


def grid_coordinates(theta_h: Tensor, theta_d: Tensor, phi_d: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Angles as coordinates in units of cells: cell i covers [i, i + 1). phi_d is reduced modulo pi."""
    return (
        torch.sqrt(theta_h * (2 / pi)) * GRID[0],
        theta_d * (GRID[1] * 2 / pi),
        torch.remainder(phi_d, pi) * (GRID[2] / pi),
    )


def cell_index(theta_h: Tensor, theta_d: Tensor, phi_d: Tensor) -> Tensor:
    """Flat index, int32, of the cell that holds each angle triple, in file order."""
    coordinates = zip(grid_coordinates(theta_h, theta_d, phi_d), GRID, strict=True)
    h, d, p = (c.to(torch.int32).clamp_(0, n - 1) for c, n in coordinates)
    return (h * GRID[1] + d) * GRID[2] + p


def mirrored_cells(cells: Tensor) -> Tensor:
    """The flat indices of the cells at -phi_d: of the pairs of directions that the plane of incidence mirrors."""
    return cells + (GRID[2] - 1) - 2 * (cells % GRID[2])
