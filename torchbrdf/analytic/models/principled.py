"""The principled BRDF of Disney, as Mitsuba evaluates it: without transmission and anisotropy."""

from math import pi

import torch
from torch import Tensor

from torchbrdf.analytic.fresnel import dielectric, normal_incidence, schlick_weight
from torchbrdf.analytic.microfacet import ggx_distribution, ggx_unmasked, ggx_visibility
from torchbrdf.analytic.model import BASE_COLOR, METALLIC, ROUGHNESS, AnalyticModel, Parameter
from torchbrdf.analytic.shading_geometry import ShadingGeometry

LUMINANCE = (0.212671, 0.715160, 0.072169)
"""Weights of linear R, G and B of sRGB in Y, to the digits of Mitsuba."""

_CLEARCOAT_MASKING = 0.25
_CLEARCOAT_F0 = 0.04


def index_of(specular: Tensor) -> Tensor:
    """eta = 2 / (1 - sqrt(0.08 specular)) - 1, so that F0 = 0.08 specular [Bur12, sec. 5.5]."""
    return 2 / (1 - (0.08 * specular).clamp_min(1e-8).sqrt()) - 1


def tint_of(base_color: Tensor) -> Tensor:
    """The colour over its luminance, 1 where that is 0; (..., 3), or (..., 1) of a grey."""
    weights = base_color.new_tensor(LUMINANCE)
    luminance = (base_color * weights).sum(-1, keepdim=True)
    lit = luminance > 0
    return torch.where(lit, base_color / torch.where(lit, luminance, 1), 1)


def principled(
    geometry: ShadingGeometry,
    base_color: Tensor,
    roughness: Tensor,
    metallic: Tensor,
    specular: Tensor,
    spec_tint: Tensor,
    sheen: Tensor,
    sheen_tint: Tensor,
    flatness: Tensor,
    clearcoat: Tensor,
    clearcoat_gloss: Tensor,
) -> Tensor:
    """Diffuse with retro-reflection or flatness, sheen, a GGX lobe of alpha = roughness^2, and a GTR1 clear coat.

    All parameters are in [0, 1]. Mitsuba takes max(roughness^2, 0.001) for alpha and calls for specular > 0; within the
    bounds of `MODELS` there is no difference.

    Source: [Bur12], [Bur15], with the changes of Mitsuba 3's `principled`: F of the dielectric is exact unless tinted,
    the metal and the tint use Schlick's, and the GGX lobe has Smith's separable G.
    """
    eta, tint = index_of(specular), tint_of(base_color)
    weight_d = schlick_weight(geometry.cos_d)
    dielectric_share = 1 - metallic

    body = _body(geometry, roughness, flatness)
    f_r = base_color * (dielectric_share / pi * body)
    f_r = f_r + (1 + sheen_tint * (tint - 1)) * (sheen * dielectric_share * weight_d)

    lobe = ggx_distribution(geometry, roughness.square()) * ggx_visibility(geometry, roughness.square())
    tinted = dielectric_share * spec_tint
    f0 = metallic * base_color + tinted * normal_incidence(eta) * tint
    grey = (metallic + tinted) * weight_d + (dielectric_share - tinted) * dielectric(geometry.cos_d, eta)
    coat = clearcoat * _coat(geometry, clearcoat_gloss, weight_d)
    return f_r + f0 * ((1 - weight_d) * lobe) + (grey * lobe + coat)


def _body(geometry: ShadingGeometry, roughness: Tensor, flatness: Tensor) -> Tensor:
    """pi times the diffuse BRDF of a white surface [Bur12, sec. 5.3], [Bur15]."""
    weight_i, weight_o = schlick_weight(geometry.cos_i), schlick_weight(geometry.cos_o)
    retro = 2 * roughness * geometry.cos_d.square()
    diffuse = (1 - weight_i / 2) * (1 - weight_o / 2)
    diffuse = diffuse + retro * (weight_i + weight_o + weight_i * weight_o * (retro - 1))
    grazing = retro / 2 - 1
    flat = (1 + grazing * weight_i) * (1 + grazing * weight_o)
    flat = 1.25 * (flat * (1 / (geometry.cos_i + geometry.cos_o) - 0.5) + 0.5)
    return diffuse + flatness * (flat - diffuse)


def _coat(geometry: ShadingGeometry, gloss: Tensor, weight_d: Tensor) -> Tensor:
    """F D G / 4 of the clear coat: GTR1 of alpha 0.1 (gloss 0) to 0.001, Smith's G of alpha 0.25 [Bur12, sec. 5.4]."""
    alpha2 = (0.1 + gloss * (0.001 - 0.1)).square()
    distribution = (alpha2 - 1) / (pi * torch.log(alpha2) * (geometry.sin2_h + alpha2 * geometry.cos_h.square()))
    masking = geometry.cos_i.new_tensor(_CLEARCOAT_MASKING)
    g_i, g_o = (cosine / ggx_unmasked(cosine, masking) for cosine in (geometry.cos_i, geometry.cos_o))
    reflected = _CLEARCOAT_F0 + (1 - _CLEARCOAT_F0) * weight_d
    return reflected * distribution * (g_i * g_o) / 4


def _part(name: str) -> Parameter:
    """A share; it starts small but not at 0, where what it scales has no slope."""
    return Parameter(name, 0.0, 1.0, 0.1)


MODEL = AnalyticModel(
    "principled",
    principled,
    (
        BASE_COLOR,
        ROUGHNESS,
        METALLIC,
        Parameter("specular", 1e-3, 1.0, 0.5),
        *(_part(name) for name in ("spec_tint", "sheen", "sheen_tint", "flatness", "clearcoat")),
        Parameter("clearcoat_gloss", 0.0, 1.0, 0.5),
    ),
    "Bur12",
    channels_coupled=True,
)
