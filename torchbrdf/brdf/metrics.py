"""What a BRDF is judged by on the MERL grid: the map of f_r cos(theta_i) of each metric, and the measure of each cell.

A metric is the norm of the difference of two mapped BRDFs in the measure dw_i dw_o. "l2" sees highlights and little
else; "log" [LKYU12] and "cube-root" [FFG12] make peaks smaller, so that what lies around them counts.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache
from math import pi
from types import MappingProxyType

import torch
from torch import Tensor

from torchbrdf.brdf.directions import from_half_difference
from torchbrdf.brdf.merl_grid import GRID, above_horizon, cell_centres, row_edges
from torchbrdf.brdf.settings import METRIC_NAMES
from torchbrdf.lasting import lasting

CUBE_ROOT_OFFSET = 1e-8
"""In 1/sr: gives the cube root a finite slope at 0. Half the cells of the darkest MERL material, black obsidian, hold
more than 1,600 times as much."""


def _itself(cos_weighted: Tensor) -> Tensor:
    return cos_weighted


def _cube_root(cos_weighted: Tensor) -> Tensor:
    return (cos_weighted + CUBE_ROOT_OFFSET) ** (1 / 3) - CUBE_ROOT_OFFSET ** (1 / 3)


METRICS: Mapping[str, Callable[[Tensor], Tensor]] = MappingProxyType(
    dict(zip(METRIC_NAMES, (_itself, torch.log1p, _cube_root), strict=True))
)
"""Differentiable elementwise maps of f_r cos(theta_i) >= 0 in 1/sr, each 0 at 0: x, log(1 + x), and the cube root
((x + e)^(1/3) - e^(1/3) with e = `CUBE_ROOT_OFFSET`)."""


@lru_cache(maxsize=1)
@lasting
def incident_cosine() -> Tensor:
    """(90, 90, 180) float64: cos(theta_i) at the centres of the cells, 0 where either direction is below the horizon.

    The cell of the reversed pair is the one at pi - phi_d, so a sum over all cells treats both directions alike.
    """
    w_i, _ = from_half_difference(*cell_centres())
    return w_i[..., 2] * above_horizon()


@lru_cache(maxsize=1)
@lasting
def cell_measure() -> Tensor:
    """(90, 90, 180) float64, sr^2: the integral of dw_i dw_o over each cell; 0 for cells below the horizon.

    dw_i dw_o = 4 cos(theta_d) sin(theta_d) sin(theta_h) dtheta_h dtheta_d dphi_h dphi_d  [Rus98]

    over all phi_h, and over both phi_d and phi_d + pi, which share a cell. The sum is (2 pi)^2 but for cells that the
    horizon cuts: a cell counts wholly where its centre lies above.
    """
    across = torch.cos(row_edges())
    along = torch.sin(torch.arange(GRID[1] + 1, dtype=torch.float64) / GRID[1] * (pi / 2)) ** 2
    theta_h, theta_d = across[:-1] - across[1:], 2 * (along[1:] - along[:-1])
    phi_d = 2 * (pi / GRID[2])
    return 2 * pi * phi_d * theta_h[:, None, None] * theta_d[:, None] * above_horizon()
