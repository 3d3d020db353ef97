"""How small the images of a library's columns can be, which says how exact their kernels have to be."""

from math import pi

import torch
from torch import Tensor

from torchbrdf.brdf.directions import half_difference
from torchbrdf.brdf.merl_grid import N_CELLS, cell_index
from torchbrdf.brdf.stored_columns import StoredColumns

_SAMPLES = 1 << 19
_RINGS = 16
"""Directions, and ranges of normals, over which means are taken."""

_ROWS_AT_ONCE = 1 << 14


def column_norms(stored: StoredColumns) -> Tensor:
    """(n,) float64: how small the image of a column can be, per unit of a Lambertian surface's, with albedo 1.

    The smaller of two ratios: of kernels, root mean square (white noise for light, or one lamp), and of images under
    uniform light. A Lambertian kernel is smooth, so smoothing the light weakens no error more than that kernel: an
    error of the kernels below a tolerance times these norms stays below it under sources of any size between.
    """
    engine = torch.quasirandom.SobolEngine(3, scramble=True, seed=0)
    u = engine.draw(_SAMPLES, dtype=torch.float32).double()
    gamma, phi = torch.asin(u[:, 0].sqrt()), 2 * pi * u[:, 2]
    ring = (u[:, 0] * _RINGS).long()
    cosine = 1 - 2 * u[:, 1]  # of beta
    sine = (1 - cosine.square()).sqrt()
    x, y, z = sine * torch.cos(phi), sine * torch.sin(phi), cosine
    sg, cg = torch.sin(gamma), torch.cos(gamma)
    w_i = torch.stack([x * cg - z * sg, y, x * sg + z * cg], -1)
    w_o = torch.stack([-sg, torch.zeros_like(sg), cg], -1)
    lit = w_i[:, 2] > 0
    w_i, w_o, ring = w_i[lit], w_o[lit], ring[lit]
    cell = cell_index(*half_difference(w_i, w_o)).long()
    white = torch.zeros(N_CELLS, dtype=torch.float64).index_add_(0, cell, w_i[:, 2].square())
    uniform = torch.zeros(_RINGS, N_CELLS, dtype=torch.float32)
    uniform.index_put_((ring, cell), w_i[:, 2].float(), accumulate=True)
    n = stored.columns.shape[1]
    power, brightness = torch.zeros(n, dtype=torch.float64), torch.zeros(_RINGS, n, dtype=torch.float64)
    for cells in torch.nonzero(white).ravel().split(_ROWS_AT_ONCE):
        rows = stored.columns[cells].float() * stored.scale.float()
        power += (rows.square().T.double() @ white[cells])
        brightness += (uniform[:, cells] @ rows).double()
    lambert = torch.stack([white.sum().sqrt(), uniform.sum(1).double().norm()]) / pi
    ratios = torch.stack([power.sqrt(), brightness.norm(dim=0)]) / lambert[:, None]
    # The samples' density makes a mean over them 1 / (2 pi) of the integral over rings, elevations and azimuths.
    kernel_norm = (2 * pi * white.sum() / _SAMPLES).sqrt() / pi
    return ratios.amin(0).clamp_min(torch.finfo(torch.float32).tiny) * kernel_norm


def norm_settings() -> list[object]:
    """What the norms depend on beside the library."""
    return [_SAMPLES, _RINGS]
