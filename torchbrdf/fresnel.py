"""Fresnel factors: the share of light that a smooth boundary reflects."""

from torch import Tensor


def schlick(cos_d: Tensor, f0: Tensor) -> Tensor:
    """F = F0 + (1 - F0) (1 - cos theta_d)^5, from F0 at normal incidence to 1 at grazing [Sch94, eq. 24]."""
    return f0 + (1 - f0) * (1 - cos_d) ** 5
