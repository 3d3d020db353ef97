"""Analytic BRDFs as pure functions of a geometry and of parameters that broadcast against its (..., 1) fields.

Each returns f_r in 1/sr without the cosine; what it gives below the horizon is finite and means nothing.
"""

from math import pi

from torch import Tensor

from torchbrdf.fresnel import schlick
from torchbrdf.shading_geometry import ShadingGeometry


def lambert(geometry: ShadingGeometry, diffuse: Tensor) -> Tensor:
    """f_r = diffuse / pi [Lam60]."""
    return (diffuse / pi).expand_as(geometry.cos_i * diffuse)


def ggx_distribution(geometry: ShadingGeometry, roughness: Tensor) -> Tensor:
    """D of GGX, alpha = roughness [WMLT07, eq. 33]."""
    squared = roughness.square()
    return squared / (pi * (geometry.cos_h.square() * squared + geometry.sin2_h).square())


def ggx_visibility(geometry: ShadingGeometry, roughness: Tensor) -> Tensor:
    """G / (4 cos theta_i cos theta_o), with Smith's separable G = G1(i) G1(o) of GGX [WMLT07, eq. 34]."""
    squared = roughness.square()

    def half(cosine: Tensor) -> Tensor:  # cosine / G1, without a division by the cosine
        return (cosine + (squared + (1 - squared) * cosine.square()).sqrt()) / 2

    return 1 / (4 * half(geometry.cos_i) * half(geometry.cos_o))


def ggx(geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, roughness: Tensor) -> Tensor:
    """Lambert and D F G / (4 cos theta_i cos theta_o), with GGX, separable Smith and Schlick's F [WMLT07, eq. 20].

    diffuse, specular  albedo, and F0
    roughness          alpha
    """
    lobe = ggx_distribution(geometry, roughness) * ggx_visibility(geometry, roughness)
    return lambert(geometry, diffuse) + schlick(geometry.cos_d, specular) * lobe
