"""The BRDF of Cook and Torrance, with Schlick's Fresnel factor."""

from math import pi

from torch import Tensor

from torchbrdf.analytic.fresnel import schlick
from torchbrdf.analytic.microfacet import beckmann_distribution, v_groove_visibility
from torchbrdf.analytic.model import DIFFUSE, F0, SLOPE, WEIGHT, AnalyticModel
from torchbrdf.analytic.shading_geometry import ShadingGeometry


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


MODEL = AnalyticModel("cook-torrance", cook_torrance, (DIFFUSE, WEIGHT, F0, SLOPE), "CT82")
