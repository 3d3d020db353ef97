"""The core material of glTF 2.0: base colour, metallic and roughness."""

from math import pi

from torch import Tensor

from torchbrdf.analytic.fresnel import schlick
from torchbrdf.analytic.microfacet import ggx_distribution, ggx_visibility
from torchbrdf.analytic.model import BASE_COLOR, METALLIC, ROUGHNESS, AnalyticModel
from torchbrdf.analytic.shading_geometry import ShadingGeometry

DIELECTRIC_F0 = 0.04
"""F at normal incidence of what is no metal."""


def metallic_roughness(
    geometry: ShadingGeometry, base_color: Tensor, metallic: Tensor, roughness: Tensor
) -> Tensor:
    """f_r = (1 - F) c_diff / pi + F D G / (4 cos theta_i cos theta_o), with GGX, separable Smith and Schlick's F.

    c_diff = (1 - metallic) base_color,  F0 = (1 - metallic) 0.04 + metallic base_color,  alpha = roughness^2

    metallic, roughness  in [0, 1]

    The diffuse part lacks only what F at theta_d takes: at grazing angles a white, smooth dielectric reflects up to
    half as much again as comes in. Source: [Khr21, appendix B].
    """
    alpha = roughness.square()
    lobe = ggx_distribution(geometry, alpha) * ggx_visibility(geometry, alpha)
    below = base_color * ((1 - metallic) / pi)
    f0 = DIELECTRIC_F0 + metallic * (base_color - DIELECTRIC_F0)
    return below + schlick(geometry.cos_d, f0) * (lobe - below)


MODEL = AnalyticModel("metallic-roughness", metallic_roughness, (BASE_COLOR, METALLIC, ROUGHNESS), "Khr21")
