"""Values of all cells, and the bounds of a library."""

from functools import lru_cache

import torch
from torch import Tensor

from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.estimation.energy_bounds import EnergyBounds


@lru_cache(maxsize=1)
def tiny_bounds(library: MaterialLibrary) -> EnergyBounds:
    return EnergyBounds.of(library)


def all_values(library: MaterialLibrary, weights: Tensor) -> Tensor:
    """(N_CELLS, N): B w in float64 for weights (N, n)."""
    stored = library.stored
    scaled = (weights * stored.scale[library.column_index]).mT
    return torch.cat([block.double() @ scaled for block in stored.columns[:, library.column_index].split(50_000)])
