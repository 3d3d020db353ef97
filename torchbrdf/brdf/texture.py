"""A measured table as a texture for the browser: coarser in phi_d, in half floats."""

from math import frexp

import numpy as np
import torch

from torchbrdf.brdf.merl import MerlTable
from torchbrdf.brdf.merl_grid import GRID

LAYERS = 12
"""Of phi_d, 15 degrees each: a table loses 0.5 to 2.5 % (L2). Folding phi_d to [0, 90] degrees by mirror symmetry,
which measured tables lack, would lose 2 to 4 % (docs/compare.md)."""

_LARGEST = 2**15
"""What the largest value is scaled below: half floats end at 65,504."""


def brdf_texture(table: MerlTable) -> tuple[np.ndarray, float]:
    """A table as (LAYERS, 90, 90, 3) float16 over phi_d, theta_d and theta_h, to be multiplied by a scale.

    theta_h keeps MERL's rows and warp, so that linear filtering of the texture is `MerlTable.lookup(..., "linear")`
    but for phi_d, in which a layer is the mean of its cells; layers repeat after 180 degrees. Unmeasured cells count
    only where a layer has no other; negative f_r becomes 0. The scale is a power of two.
    """
    cells = (*GRID[:2], LAYERS, GRID[2] // LAYERS)
    valid = table.valid.cpu().reshape(*cells, 1).double()
    weights = torch.where(valid.sum(3, keepdim=True) > 0, valid, 1.0)
    values = table.filled.detach().cpu().double().reshape(*cells, 3).clamp_min(0)
    layers = (values * weights).sum(3) / weights.sum(3)
    scale = 2.0 ** (frexp(float(layers.max()))[1] - frexp(_LARGEST - 1)[1])
    return np.ascontiguousarray((layers / scale).permute(2, 1, 0, 3).numpy(), "<f2"), scale
