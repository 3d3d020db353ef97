"""Priors of the whole library: every basis BRDF may deviate, those with high peaks less."""

import torch
from torch import Tensor

POWERS = (0.0, 0.25, 0.5)
"""p of S = |b_i|^(-2 p), so that BRDFs with high peaks may deviate less: of the whole library and of neighbourhoods."""


def whole_variances(norms: Tensor) -> Tensor:
    """S (L, n) with every power, of norms |b_i| (n,)."""
    middle = norms[norms > 0].log().mean().exp() if (norms > 0).any() else norms.new_ones(())
    relative = torch.where(norms > 0, norms / middle, 1)
    return torch.stack([relative ** (-2 * power) for power in POWERS])
