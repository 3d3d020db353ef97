"""Lambert below a lobe of GGX with the exact Fresnel factor of a dielectric."""

from math import pi

from torch import Tensor

from torchbrdf.analytic.fresnel import dielectric
from torchbrdf.analytic.microfacet import ggx_distribution, ggx_visibility
from torchbrdf.analytic.model import ALPHA, DIFFUSE, ETA, WEIGHT, AnalyticModel
from torchbrdf.analytic.shading_geometry import ShadingGeometry


def ggx_dielectric(
    geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, eta: Tensor, roughness: Tensor
) -> Tensor:
    """`ggx` with the exact F of a dielectric of index eta, and a weight `specular` of the lobe [WMLT07, eq. 20]."""
    lobe = ggx_distribution(geometry, roughness) * ggx_visibility(geometry, roughness)
    return diffuse / pi + specular * (dielectric(geometry.cos_d, eta) * lobe)


MODEL = AnalyticModel("ggx-dielectric", ggx_dielectric, (DIFFUSE, WEIGHT, ETA, ALPHA), "WMLT07")
