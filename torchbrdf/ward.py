"""The isotropic BRDF of Ward, and those that mend how it behaves at grazing angles."""

from math import pi

import torch
from torch import Tensor

from torchbrdf.microfacet import beckmann_distribution
from torchbrdf.shading_geometry import LEAST_COSINE, ShadingGeometry


def _gaussian(geometry: ShadingGeometry, roughness: Tensor) -> Tensor:
    """exp(-tan^2 theta_h / alpha^2) / (4 pi alpha^2)."""
    squared = roughness.square()
    return torch.exp(-geometry.tan2_h / squared) / (4 * pi * squared)


def ward(geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, roughness: Tensor) -> Tensor:
    """Lambert and specular exp(-tan^2 theta_h / alpha^2) / (4 pi alpha^2 sqrt(cos theta_i cos theta_o)) [War92, eq. 4].

    Loses energy towards grazing angles [Due06].

    diffuse, specular  albedo, and about that of the lobe at normal incidence
    roughness          alpha, standard deviation of the slopes
    """
    lobe = _gaussian(geometry, roughness) * (geometry.cos_i * geometry.cos_o).rsqrt()
    return diffuse / pi + specular * lobe


def ward_duer(geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, roughness: Tensor) -> Tensor:
    """`ward` divided by cos theta_i cos theta_o instead of its root: its albedo has no bound at grazing [Due06]."""
    lobe = _gaussian(geometry, roughness) / (geometry.cos_i * geometry.cos_o)
    return diffuse / pi + specular * lobe


def ward_bounded(geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, roughness: Tensor) -> Tensor:
    """Lambert and specular exp(-tan^2 theta_h / alpha^2) / (4 pi alpha^2 cos^2 theta_d cos^4 theta_h) [GMD10].

    At most `specular` of the light from any direction is reflected by the lobe.
    """
    lobe = beckmann_distribution(geometry, roughness) / (4 * geometry.cos_d.square().clamp_min(LEAST_COSINE**2))
    return diffuse / pi + specular * lobe
