"""The diffuse BRDF of Oren and Nayar: a rough surface of Lambertian facets."""

from math import pi

import torch
from torch import Tensor

from torchbrdf.analytic.model import DIFFUSE, AnalyticModel, Parameter
from torchbrdf.analytic.shading_geometry import ShadingGeometry


def oren_nayar(geometry: ShadingGeometry, diffuse: Tensor, roughness: Tensor) -> Tensor:
    """f_r = diffuse / pi (A + B max(0, cos(phi_i - phi_o)) sin alpha tan beta), the qualitative model.

    A = 1 - 0.5 s^2 / (s^2 + 0.33),  B = 0.45 s^2 / (s^2 + 0.09)

    alpha is the larger and beta the smaller of theta_i and theta_o. Light that hits several facets is left out.

    diffuse    albedo of a facet
    roughness  s, standard deviation of the angle of facets, radian

    The fit of the qualitative model to the full one lets 0.3 % too much out at grazing angles. Source: [ON94, eq. 30].
    """
    squared = roughness.square()
    level = 1 - 0.5 * squared / (squared + 0.33)
    retro = 0.45 * squared / (squared + 0.09)
    # sin theta_i sin theta_o cos(phi_i - phi_o) = w_i . w_o - cos theta_i cos theta_o
    across = 2 * geometry.cos_d.square() - 1 - geometry.cos_i * geometry.cos_o
    shape = across.clamp_min(0) / torch.maximum(geometry.cos_i, geometry.cos_o)
    return (diffuse / pi) * (level + retro * shape)


MODEL = AnalyticModel("oren-nayar", oren_nayar, (DIFFUSE, Parameter("roughness", 0.0, 1.5, 0.3)), "ON94")
