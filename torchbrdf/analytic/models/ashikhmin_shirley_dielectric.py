"""The BRDF of Ashikhmin and Shirley, with the exact Fresnel factor of a dielectric."""

from math import pi

from torch import Tensor

from torchbrdf.analytic.fresnel import dielectric
from torchbrdf.analytic.model import DIFFUSE, ETA, SHARPNESS, WEIGHT, AnalyticModel
from torchbrdf.analytic.models.ashikhmin_shirley import phong_lobe
from torchbrdf.analytic.shading_geometry import ShadingGeometry


def ashikhmin_shirley_dielectric(
    geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, eta: Tensor, sharpness: Tensor
) -> Tensor:
    """`ashikhmin_shirley` with the exact F of a dielectric of index eta, as it is fitted by [LKYU12]."""
    return diffuse / pi + specular * (dielectric(geometry.cos_d, eta) * phong_lobe(geometry, sharpness))


MODEL = AnalyticModel(
    "ashikhmin-shirley-dielectric", ashikhmin_shirley_dielectric, (DIFFUSE, WEIGHT, ETA, SHARPNESS), "LKYU12"
)
