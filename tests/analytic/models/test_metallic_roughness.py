from math import pi

import pytest
import torch

from bsdf_cases import direction_pairs, numbers, some_geometry
from torchbrdf.analytic.catalogue import MODELS
from torchbrdf.analytic.shading_geometry import ShadingGeometry


def by_the_specification(w_i, w_o, base, metallic: float, roughness: float):
    """Appendix B, line by line, on vectors."""
    h = torch.nn.functional.normalize(w_i + w_o, dim=-1)
    n_h, n_l, n_v, v_h = h[:, 2], w_i[:, 2], w_o[:, 2], (w_o * h).sum(-1)
    alpha2 = roughness**4
    d = alpha2 / (pi * (n_h**2 * (alpha2 - 1) + 1) ** 2)
    g = (2 * n_l / (n_l + (alpha2 + (1 - alpha2) * n_l**2).sqrt())) * (
        2 * n_v / (n_v + (alpha2 + (1 - alpha2) * n_v**2).sqrt())
    )
    c_diff = base * (1 - metallic)
    f0 = 0.04 * (1 - metallic) + base * metallic
    f = f0 + (1 - f0) * ((1 - v_h) ** 5)[:, None]
    return (1 - f) * c_diff / pi + f * (d * g / (4 * n_l * n_v))[:, None]


@pytest.mark.parametrize(("metallic", "roughness"), [(0.0, 0.3), (1.0, 0.5), (0.4, 0.8)])
def test_it_is_the_appendix_of_the_specification(metallic: float, roughness: float):
    w_i, w_o = direction_pairs(400, seed=9)
    base = (0.9, 0.4, 0.1)
    expected = by_the_specification(w_i, w_o, torch.tensor(base, dtype=torch.float64), metallic, roughness)
    values = numbers(base_color=base, metallic=metallic, roughness=roughness)
    ours = MODELS["metallic-roughness"].evaluate(values, ShadingGeometry.of_directions(w_i, w_o))
    torch.testing.assert_close(ours, expected, rtol=1e-5, atol=1e-9)


def test_a_metal_is_ggx_of_its_colour():
    geometry = some_geometry()
    metal = numbers(base_color=(0.9, 0.6, 0.3), metallic=1.0, roughness=0.5)
    ggx = numbers(diffuse=0.0, specular=(0.9, 0.6, 0.3), roughness=0.25)
    torch.testing.assert_close(
        MODELS["metallic-roughness"].evaluate(metal, geometry), MODELS["ggx"].evaluate(ggx, geometry)
    )
