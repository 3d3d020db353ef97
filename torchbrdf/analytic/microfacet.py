"""What microfacet BRDFs are made of: distributions D, with integral D cos theta_h dw = 1, and visibilities.

A visibility is G / (4 cos theta_i cos theta_o). Parameters broadcast against the (..., 1) fields of a geometry.
"""

from math import pi

import torch
from torch import Tensor

from torchbrdf.analytic.shading_geometry import LEAST_COSINE, ShadingGeometry


def ggx_distribution(geometry: ShadingGeometry, roughness: Tensor) -> Tensor:
    """D of GGX, alpha = roughness [WMLT07, eq. 33]."""
    squared = roughness.square()
    return squared / (pi * (geometry.cos_h.square() * squared + geometry.sin2_h).square())


def beckmann_distribution(geometry: ShadingGeometry, roughness: Tensor) -> Tensor:
    """D = exp(-tan^2 theta_h / m^2) / (pi m^2 cos^4 theta_h), m = roughness [WMLT07, eq. 25]."""
    squared = roughness.square()
    tan2 = geometry.tan2_h
    return (1 + tan2).square() * torch.exp(-tan2 / squared) / (pi * squared)


def ggx_unmasked(cosine: Tensor, roughness: Tensor) -> Tensor:
    """cos theta / G1(theta) of GGX, without a division by the cosine: (c + sqrt(a^2 + (1 - a^2) c^2)) / 2.

    cosine     c, to the normal, at least 0
    roughness  a = alpha

    Source: [WMLT07, eq. 34].
    """
    squared = roughness.square()
    return (cosine + (squared + (1 - squared) * cosine.square()).sqrt()) / 2


def ggx_visibility(geometry: ShadingGeometry, roughness: Tensor) -> Tensor:
    """G / (4 cos theta_i cos theta_o), with Smith's separable G = G1(i) G1(o) of GGX [WMLT07, eq. 34]."""
    return 1 / (4 * ggx_unmasked(geometry.cos_i, roughness) * ggx_unmasked(geometry.cos_o, roughness))


def v_groove_visibility(geometry: ShadingGeometry) -> Tensor:
    """G / (4 cos theta_i cos theta_o), G = min(1, 2 cos theta_h min(cos theta_i, cos theta_o) / cos theta_d).

    Source: [CT82].
    """
    cos_i, cos_o = geometry.cos_i, geometry.cos_o
    grooves = geometry.cos_h / (2 * geometry.cos_d.clamp_min(LEAST_COSINE) * torch.maximum(cos_i, cos_o))
    return torch.minimum(1 / (4 * cos_i * cos_o), grooves)


