from math import cos, pi, sin, tan

import pytest
import torch

from bsdf_cases import albedo, numbers, some_geometry
from torchbrdf.analytic.catalogue import MODELS
from torchbrdf.analytic.shading_geometry import ShadingGeometry


def test_a_smooth_surface_is_lambertian():
    f_r = MODELS["oren-nayar"].evaluate(numbers(diffuse=(0.2, 0.5, 0.8), roughness=0.0), some_geometry())
    torch.testing.assert_close(f_r, (torch.tensor([0.2, 0.5, 0.8]).double() / pi).expand_as(f_r))


@pytest.mark.parametrize(
    ("theta_i", "theta_o", "apart"), [(0.3, 1.0, 0.4), (1.2, 0.2, 0.0), (0.7, 0.7, 1.1), (0.5, 0.9, 2.5)]
)
def test_it_is_the_formula_of_the_paper(theta_i: float, theta_o: float, apart: float):
    w_i = torch.tensor([[sin(theta_i), 0, cos(theta_i)]], dtype=torch.float64)
    across = [sin(theta_o) * cos(apart), sin(theta_o) * sin(apart)]
    w_o = torch.tensor([[*across, cos(theta_o)]], dtype=torch.float64)
    s2 = 0.6**2
    level, retro = 1 - 0.5 * s2 / (s2 + 0.33), 0.45 * s2 / (s2 + 0.09)
    shape = max(0.0, cos(apart)) * sin(max(theta_i, theta_o)) * tan(min(theta_i, theta_o))
    ours = MODELS["oren-nayar"].evaluate(numbers(diffuse=0.5, roughness=0.6), ShadingGeometry.of_directions(w_i, w_o))
    assert float(ours[0, 0]) == pytest.approx(0.5 / pi * (level + retro * shape), rel=1e-9)


@pytest.mark.parametrize("roughness", [0.3, 1.0])
@pytest.mark.parametrize("cosine", [1.0, 0.4, 0.05])
def test_white_facets_send_back_nearly_all_and_never_more(roughness: float, cosine: float):
    """0.3 % more at grazing angles, where the qualitative model is a fit."""
    assert 0.5 < float(albedo("oren-nayar", numbers(diffuse=1.0, roughness=roughness), cosine)[0]) < 1.004
