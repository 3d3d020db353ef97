"""Lambert below a lobe of GGX with Schlick's Fresnel factor."""

from math import pi

from torch import Tensor

from torchbrdf.analytic.fresnel import schlick
from torchbrdf.analytic.microfacet import ggx_distribution, ggx_visibility
from torchbrdf.analytic.model import ALPHA, DIFFUSE, SPECULAR_F0, AnalyticModel
from torchbrdf.analytic.shading_geometry import ShadingGeometry


def ggx(geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, roughness: Tensor) -> Tensor:
    """Lambert and D F G / (4 cos theta_i cos theta_o), with GGX, separable Smith and Schlick's F [WMLT07, eq. 20].

    diffuse, specular  albedo, and F0
    roughness          alpha
    """
    lobe = ggx_distribution(geometry, roughness) * ggx_visibility(geometry, roughness)
    return diffuse / pi + schlick(geometry.cos_d, specular) * lobe


MODEL = AnalyticModel("ggx", ggx, (DIFFUSE, SPECULAR_F0, ALPHA), "WMLT07")
