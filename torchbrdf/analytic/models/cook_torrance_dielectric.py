"""The BRDF of Cook and Torrance, with the exact Fresnel factor of a dielectric."""

from math import pi

from torch import Tensor

from torchbrdf.analytic.fresnel import dielectric
from torchbrdf.analytic.microfacet import beckmann_distribution, v_groove_visibility
from torchbrdf.analytic.model import DIFFUSE, ETA, SLOPE, WEIGHT, AnalyticModel
from torchbrdf.analytic.shading_geometry import ShadingGeometry


def cook_torrance_dielectric(
    geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, eta: Tensor, roughness: Tensor
) -> Tensor:
    """`cook_torrance` with the exact F of a dielectric of index eta, as in the paper [CT82]."""
    lobe = beckmann_distribution(geometry, roughness) * v_groove_visibility(geometry)
    return diffuse / pi + specular * (dielectric(geometry.cos_d, eta) * lobe)


MODEL = AnalyticModel("cook-torrance-dielectric", cook_torrance_dielectric, (DIFFUSE, WEIGHT, ETA, SLOPE), "CT82")
