"""The prior of the whole library: every basis BRDF may deviate, those with high peaks less."""

import torch
from torch import Tensor

POWER = 0.25
"""p of S = |b_i|^(-2 p), so that BRDFs with high peaks may deviate less: of the whole library and of neighbourhoods."""


def whole_variances(norms: Tensor, power: float | None = None) -> Tensor:
    """S (n,) of norms |b_i| (n,); default: with POWER."""
    middle = norms[norms > 0].log().mean().exp() if (norms > 0).any() else norms.new_ones(())
    return torch.where(norms > 0, norms / middle, 1) ** (-2 * (POWER if power is None else power))
