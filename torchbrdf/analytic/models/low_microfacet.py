"""The microfacet BRDF that Low et al. fit to measurements."""

from math import pi

import torch
from torch import Tensor

from torchbrdf.analytic.fresnel import dielectric
from torchbrdf.analytic.microfacet import v_groove_visibility
from torchbrdf.analytic.model import DIFFUSE, ETA, AnalyticModel, Parameter
from torchbrdf.analytic.shading_geometry import ShadingGeometry


def low_microfacet(
    geometry: ShadingGeometry, diffuse: Tensor, amplitude: Tensor, width: Tensor, decay: Tensor, eta: Tensor
) -> Tensor:
    """Lambert and F S G / (cos theta_i cos theta_o), S = A / (1 + B (1 - cos theta_h))^C.

    G is that of V-grooves, F that of a dielectric. S is no distribution: its integral depends on all of A, B and C.

    amplitude, width, decay  A, B and C
    eta                      index of refraction

    Source: [LKYU12, eq. 15].
    """
    fall = torch.exp(-decay * torch.log1p(width * geometry.versine_h))
    lobe = 4 * dielectric(geometry.cos_d, eta) * v_groove_visibility(geometry) * fall
    return diffuse / pi + amplitude * lobe


MODEL = AnalyticModel(
    "low-microfacet",
    low_microfacet,
    (
        DIFFUSE,
        Parameter("amplitude", 1e-4, 1e4, 5.0, colour=True, logarithmic=True, starts=(0.3, 10.0, 300.0)),
        Parameter("width", 1.0, 1e7, 300.0, logarithmic=True, starts=(30.0, 1e3, 3e4)),
        Parameter("decay", 0.01, 5.0, 1.3, logarithmic=True),
        ETA,
    ),
    "LKYU12",
)
