"""A rough metal, as Mitsuba's `roughconductor` evaluates it."""

from torch import Tensor

from torchbrdf.analytic.fresnel import conductor
from torchbrdf.analytic.microfacet import ggx_distribution, ggx_visibility
from torchbrdf.analytic.model import ALPHA, AnalyticModel, Parameter
from torchbrdf.analytic.shading_geometry import ShadingGeometry


def rough_conductor(geometry: ShadingGeometry, eta: Tensor, k: Tensor, roughness: Tensor) -> Tensor:
    """D F G / (4 cos theta_i cos theta_o), with GGX, separable Smith and the F of a metal of index eta - i k.

    roughness  alpha

    Mitsuba's `roughconductor` with distribution "ggx".
    """
    lobe = ggx_distribution(geometry, roughness) * ggx_visibility(geometry, roughness)
    return conductor(geometry.cos_d, eta, k) * lobe


MODEL = AnalyticModel(
    "rough-conductor",
    rough_conductor,
    (
        Parameter("eta", 0.02, 10.0, 1.0, colour=True, logarithmic=True),
        Parameter("k", 0.0, 20.0, 3.0, colour=True),
        ALPHA,
    ),
    "WMLT07",
    energy_conserving=True,
)
