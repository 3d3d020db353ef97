"""The BRDF of Ward, with an albedo that is bounded at grazing angles."""

from math import pi

from torch import Tensor

from torchbrdf.analytic.microfacet import beckmann_distribution
from torchbrdf.analytic.model import AnalyticModel
from torchbrdf.analytic.models.ward import PARAMETERS
from torchbrdf.analytic.shading_geometry import LEAST_COSINE, ShadingGeometry


def ward_bounded(geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, roughness: Tensor) -> Tensor:
    """Lambert and specular exp(-tan^2 theta_h / alpha^2) / (4 pi alpha^2 cos^2 theta_d cos^4 theta_h) [GMD10].

    At most `specular` of the light from any direction is reflected by the lobe.
    """
    lobe = beckmann_distribution(geometry, roughness) / (4 * geometry.cos_d.square().clamp_min(LEAST_COSINE**2))
    return diffuse / pi + specular * lobe


MODEL = AnalyticModel("ward-bounded", ward_bounded, PARAMETERS, "GMD10")
