"""Microfacet BRDFs as pure functions of a geometry and of parameters that broadcast against its (..., 1) fields.

Each returns f_r in 1/sr without the cosine; what it gives below the horizon is finite and means nothing. D is a
distribution of microfacets with integral D cos theta_h dw = 1, F a Fresnel factor, and a visibility is
G / (4 cos theta_i cos theta_o).
"""

from math import pi

import torch
from torch import Tensor

from torchbrdf import fresnel
from torchbrdf.fresnel import schlick
from torchbrdf.shading_geometry import LEAST_COSINE, ShadingGeometry


def lambert(geometry: ShadingGeometry, diffuse: Tensor) -> Tensor:
    """f_r = diffuse / pi [Lam60]."""
    return (diffuse / pi).expand_as(geometry.cos_i * diffuse)


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


def ggx(geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, roughness: Tensor) -> Tensor:
    """Lambert and D F G / (4 cos theta_i cos theta_o), with GGX, separable Smith and Schlick's F [WMLT07, eq. 20].

    diffuse, specular  albedo, and F0
    roughness          alpha
    """
    lobe = ggx_distribution(geometry, roughness) * ggx_visibility(geometry, roughness)
    return diffuse / pi + schlick(geometry.cos_d, specular) * lobe


def ggx_dielectric(
    geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, eta: Tensor, roughness: Tensor
) -> Tensor:
    """`ggx` with the exact F of a dielectric of index eta, and a weight `specular` of the lobe [WMLT07, eq. 20]."""
    lobe = ggx_distribution(geometry, roughness) * ggx_visibility(geometry, roughness)
    return diffuse / pi + specular * (fresnel.dielectric(geometry.cos_d, eta) * lobe)


def rough_conductor(geometry: ShadingGeometry, eta: Tensor, k: Tensor, roughness: Tensor) -> Tensor:
    """D F G / (4 cos theta_i cos theta_o), with GGX, separable Smith and the F of a metal of index eta - i k.

    roughness  alpha

    Mitsuba's `roughconductor` with distribution "ggx".
    """
    lobe = ggx_distribution(geometry, roughness) * ggx_visibility(geometry, roughness)
    return fresnel.conductor(geometry.cos_d, eta, k) * lobe


def cook_torrance(
    geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, f0: Tensor, roughness: Tensor
) -> Tensor:
    """Lambert and specular D F G / (4 cos theta_i cos theta_o), with Beckmann, V-grooves and Schlick's F [CT82].

    The paper divides by pi instead of 4, and its D is pi times ours: its specular is 1/4 of ours.

    diffuse, specular  albedo, and weight of the lobe
    f0                 F at normal incidence
    roughness          m, root mean square slope
    """
    lobe = beckmann_distribution(geometry, roughness) * v_groove_visibility(geometry)
    return diffuse / pi + specular * (schlick(geometry.cos_d, f0) * lobe)


def cook_torrance_dielectric(
    geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, eta: Tensor, roughness: Tensor
) -> Tensor:
    """`cook_torrance` with the exact F of a dielectric of index eta, as in the paper [CT82]."""
    lobe = beckmann_distribution(geometry, roughness) * v_groove_visibility(geometry)
    return diffuse / pi + specular * (fresnel.dielectric(geometry.cos_d, eta) * lobe)


def low_microfacet(
    geometry: ShadingGeometry, diffuse: Tensor, amplitude: Tensor, width: Tensor, decay: Tensor, eta: Tensor
) -> Tensor:
    """Lambert and F S G / (cos theta_i cos theta_o), S = A / (1 + B (1 - cos theta_h))^C.

    G is that of V-grooves, F that of a dielectric. S is no distribution: its integral depends on all of A, B and C.

    amplitude, width, decay  A, B and C
    eta                      index of refraction

    Source: [LKYU12, eq. 15].
    """
    fall = torch.exp(-decay * torch.log1p(width * geometry.versine_h))
    lobe = 4 * fresnel.dielectric(geometry.cos_d, eta) * v_groove_visibility(geometry) * fall
    return diffuse / pi + amplitude * lobe
