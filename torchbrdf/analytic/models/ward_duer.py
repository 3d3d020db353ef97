"""The BRDF of Ward, with the normalisation of Duer."""

from math import pi

from torch import Tensor

from torchbrdf.analytic.model import AnalyticModel
from torchbrdf.analytic.models.ward import PARAMETERS, slope_gaussian
from torchbrdf.analytic.shading_geometry import ShadingGeometry


def ward_duer(geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, roughness: Tensor) -> Tensor:
    """`ward` divided by cos theta_i cos theta_o instead of its root: its albedo has no bound at grazing [Due06]."""
    lobe = slope_gaussian(geometry, roughness) / (geometry.cos_i * geometry.cos_o)
    return diffuse / pi + specular * lobe


MODEL = AnalyticModel("ward-duer", ward_duer, PARAMETERS, "Due06")
