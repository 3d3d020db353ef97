"""The isotropic BRDF of Ashikhmin and Shirley: a Phong lobe of the half vector that is reciprocal."""

from math import pi

import torch
from torch import Tensor

from torchbrdf import fresnel
from torchbrdf.fresnel import schlick, schlick_weight
from torchbrdf.shading_geometry import LEAST_COSINE, ShadingGeometry


def _phong(geometry: ShadingGeometry, sharpness: Tensor) -> Tensor:
    """(n + 1) cos^n theta_h / (8 pi cos theta_d max(cos theta_i, cos theta_o)) [AS00]."""
    below = 8 * pi * geometry.cos_d.clamp_min(LEAST_COSINE) * torch.maximum(geometry.cos_i, geometry.cos_o)
    return (sharpness + 1) * torch.exp(sharpness * geometry.log_cos_h) / below


def ashikhmin_shirley(
    geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, f0: Tensor, sharpness: Tensor
) -> Tensor:
    """Lambert and specular F (n + 1) cos^n theta_h / (8 pi cos theta_d max(cos theta_i, cos theta_o)), Schlick's F.

    diffuse, specular  albedo, and weight of the lobe
    f0                 F at normal incidence
    sharpness          n

    Source: [AS00], with a Lambertian diffuse part, as it is fitted by [NDM05].
    """
    return diffuse / pi + specular * (schlick(geometry.cos_d, f0) * _phong(geometry, sharpness))


def ashikhmin_shirley_dielectric(
    geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, eta: Tensor, sharpness: Tensor
) -> Tensor:
    """`ashikhmin_shirley` with the exact F of a dielectric of index eta, as it is fitted by [LKYU12]."""
    return diffuse / pi + specular * (fresnel.dielectric(geometry.cos_d, eta) * _phong(geometry, sharpness))


def ashikhmin_shirley_coupled(
    geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, sharpness: Tensor
) -> Tensor:
    """The model of the paper: its diffuse part is what the lobe lets through, so that energy is conserved.

    f_d = 28 R_d / (23 pi) (1 - R_s) (1 - (1 - cos theta_i / 2)^5) (1 - (1 - cos theta_o / 2)^5)

    diffuse, specular  R_d, and R_s = F0 of the lobe
    sharpness          n

    Source: [AS00].
    """
    entering = 1 - schlick_weight(geometry.cos_i / 2)
    leaving = 1 - schlick_weight(geometry.cos_o / 2)
    below = diffuse * (1 - specular) * (28 / (23 * pi))
    return below * (entering * leaving) + schlick(geometry.cos_d, specular) * _phong(geometry, sharpness)
