"""The BRDF of Ashikhmin and Shirley, with the diffuse part of the paper."""

from math import pi

from torch import Tensor

from torchbrdf.analytic.fresnel import schlick, schlick_weight
from torchbrdf.analytic.model import DIFFUSE, SHARPNESS, SPECULAR_F0, AnalyticModel
from torchbrdf.analytic.models.ashikhmin_shirley import phong_lobe
from torchbrdf.analytic.shading_geometry import ShadingGeometry


def ashikhmin_shirley_coupled(
    geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, sharpness: Tensor
) -> Tensor:
    """The model of the paper: its diffuse part is what the lobe lets through, so that energy is conserved.

    f_d = 28 R_d / (23 pi) (1 - R_s) (1 - (1 - cos theta_i / 2)^5) (1 - (1 - cos theta_o / 2)^5)

    diffuse, specular  R_d, and R_s = F0 of the lobe
    sharpness          n

    Source: [AS00].
    """
    entering = 1 - schlick_weight(geometry.cos_i / 2)
    leaving = 1 - schlick_weight(geometry.cos_o / 2)
    below = diffuse * (1 - specular) * (28 / (23 * pi))
    return below * (entering * leaving) + schlick(geometry.cos_d, specular) * phong_lobe(geometry, sharpness)


MODEL = AnalyticModel(
    "ashikhmin-shirley-coupled",
    ashikhmin_shirley_coupled,
    (DIFFUSE, SPECULAR_F0, SHARPNESS),
    "AS00",
    energy_conserving=True,
)
