"""The isotropic BRDF of Ashikhmin and Shirley: a Phong lobe of the half vector that is reciprocal."""

from math import pi

import torch
from torch import Tensor

from torchbrdf.analytic.fresnel import schlick
from torchbrdf.analytic.model import DIFFUSE, F0, SHARPNESS, WEIGHT, AnalyticModel
from torchbrdf.analytic.shading_geometry import LEAST_COSINE, ShadingGeometry


def ashikhmin_shirley(
    geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, f0: Tensor, sharpness: Tensor
) -> Tensor:
    """Lambert and specular F (n + 1) cos^n theta_h / (8 pi cos theta_d max(cos theta_i, cos theta_o)), Schlick's F.

    diffuse, specular  albedo, and weight of the lobe
    f0                 F at normal incidence
    sharpness          n

    Source: [AS00], with a Lambertian diffuse part, as it is fitted by [NDM05].
    """
    return diffuse / pi + specular * (schlick(geometry.cos_d, f0) * phong_lobe(geometry, sharpness))


def phong_lobe(geometry: ShadingGeometry, sharpness: Tensor) -> Tensor:
    """(n + 1) cos^n theta_h / (8 pi cos theta_d max(cos theta_i, cos theta_o)) [AS00]."""
    below = 8 * pi * geometry.cos_d.clamp_min(LEAST_COSINE) * torch.maximum(geometry.cos_i, geometry.cos_o)
    return (sharpness + 1) * torch.exp(sharpness * geometry.log_cos_h) / below


MODEL = AnalyticModel("ashikhmin-shirley", ashikhmin_shirley, (DIFFUSE, WEIGHT, F0, SHARPNESS), "AS00")
