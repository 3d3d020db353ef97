"""The diffuse BRDF of Lambert."""

from math import pi

from torch import Tensor

from torchbrdf.analytic.model import DIFFUSE, AnalyticModel
from torchbrdf.analytic.shading_geometry import ShadingGeometry


def lambert(geometry: ShadingGeometry, diffuse: Tensor) -> Tensor:
    """f_r = diffuse / pi [Lam60]."""
    return (diffuse / pi).expand_as(geometry.cos_i * diffuse)


MODEL = AnalyticModel("lambert", lambert, (DIFFUSE,), "Lam60", energy_conserving=True)
