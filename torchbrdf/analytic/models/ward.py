"""The isotropic BRDF of Ward."""

from dataclasses import replace
from math import pi

import torch
from torch import Tensor

from torchbrdf.analytic.model import DIFFUSE, SLOPE, WEIGHT, AnalyticModel
from torchbrdf.analytic.shading_geometry import ShadingGeometry


def ward(geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, roughness: Tensor) -> Tensor:
    """Lambert and specular exp(-tan^2 theta_h / alpha^2) / (4 pi alpha^2 sqrt(cos theta_i cos theta_o)) [War92, eq. 4].

    Loses energy towards grazing angles [Due06].

    diffuse, specular  albedo, and about that of the lobe at normal incidence
    roughness          alpha, standard deviation of the slopes
    """
    lobe = slope_gaussian(geometry, roughness) * (geometry.cos_i * geometry.cos_o).rsqrt()
    return diffuse / pi + specular * lobe


def slope_gaussian(geometry: ShadingGeometry, roughness: Tensor) -> Tensor:
    """exp(-tan^2 theta_h / alpha^2) / (4 pi alpha^2)."""
    squared = roughness.square()
    return torch.exp(-geometry.tan2_h / squared) / (4 * pi * squared)


PARAMETERS = (DIFFUSE, replace(WEIGHT, default=0.05), SLOPE)

MODEL = AnalyticModel("ward", ward, PARAMETERS, "War92")
