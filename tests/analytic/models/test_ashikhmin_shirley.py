from math import pi

import pytest
import torch

from bsdf_cases import albedo, direction_pairs, numbers, some_geometry
from torchbrdf.analytic.catalogue import MODELS
from torchbrdf.analytic.shading_geometry import ShadingGeometry

HEAD_ON = ShadingGeometry.of_angles(*torch.zeros(3, 1, dtype=torch.float64))


@pytest.mark.parametrize("sharpness", [0.0, 3.0, 1e4])
def test_head_on_values(sharpness: float):
    def lobe(name: str, **values: float) -> float:
        parameters = numbers(diffuse=0.0, sharpness=sharpness, **values)
        return float(MODELS[name].evaluate(parameters, HEAD_ON)[0, 0])

    peak = (sharpness + 1) / (8 * pi)
    assert lobe("ashikhmin-shirley", specular=0.5, f0=0.3) == pytest.approx(0.15 * peak)
    assert lobe("ashikhmin-shirley-dielectric", specular=0.5, eta=1.5) == pytest.approx(0.02 * peak)
    assert lobe("ashikhmin-shirley-coupled", specular=0.3) == pytest.approx(0.3 * peak)


def test_it_is_the_formula_of_the_paper():
    w_i, w_o = direction_pairs(300, seed=2)
    h = torch.nn.functional.normalize(w_i + w_o, dim=-1)
    n, f0 = 200.0, 0.1
    f = f0 + (1 - f0) * (1 - (w_i * h).sum(-1)) ** 5
    expected = (n + 1) / (8 * pi) * h[:, 2] ** n * f / ((w_i * h).sum(-1) * torch.maximum(w_i[:, 2], w_o[:, 2]))
    values = numbers(diffuse=0.0, specular=1.0, f0=f0, sharpness=n)
    ours = MODELS["ashikhmin-shirley"].evaluate(values, ShadingGeometry.of_directions(w_i, w_o))
    torch.testing.assert_close(ours[:, 0], expected, rtol=1e-4, atol=1e-9)


def test_a_sharp_lobe_is_a_mirror():
    reflected = albedo("ashikhmin-shirley", numbers(diffuse=0.0, specular=1.0, f0=0.4, sharpness=1e4), 1.0)
    torch.testing.assert_close(reflected, torch.full((3,), 0.4, dtype=torch.float64), rtol=1e-3, atol=0)


@pytest.mark.parametrize("specular", [0.0, 0.04, 0.5, 1.0])
@pytest.mark.parametrize("cosine", [1.0, 0.5, 0.05])
def test_the_coupled_diffuse_part_takes_what_the_lobe_leaves(specular: float, cosine: float):
    values = numbers(diffuse=1.0, specular=specular, sharpness=1e3)
    whole = float(albedo("ashikhmin-shirley-coupled", values, cosine)[0])
    assert whole <= 1
    assert whole > 0.75 or cosine < 0.1


def test_the_coupled_diffuse_part_is_that_of_the_paper():
    geometry = some_geometry()
    values = numbers(diffuse=0.6, specular=0.2, sharpness=50.0)
    whole = MODELS["ashikhmin-shirley-coupled"].evaluate(values, geometry)
    lobe = MODELS["ashikhmin-shirley-coupled"].evaluate({**values, "diffuse": torch.zeros(1).double()}, geometry)
    fades = [1 - (1 - cosine / 2) ** 5 for cosine in (geometry.cos_i, geometry.cos_o)]
    expected = 28 * 0.6 / (23 * pi) * 0.8 * fades[0] * fades[1]
    torch.testing.assert_close(whole - lobe, expected.expand(-1, 3), rtol=1e-9, atol=1e-12)


def test_very_sharp_lobes_keep_their_digits_in_single_precision():
    theta = torch.tensor([0.0, 3e-4, 1e-3, 3e-3], dtype=torch.float64)
    geometry = ShadingGeometry.of_angles(theta, torch.full_like(theta, 0.5), torch.full_like(theta, 1.0))
    values = numbers(diffuse=0.0, specular=1.0, f0=0.04, sharpness=1e6)
    exact = MODELS["ashikhmin-shirley"].evaluate(values, geometry)
    single = MODELS["ashikhmin-shirley"].evaluate({k: v.float() for k, v in values.items()}, geometry.to(torch.float32))
    torch.testing.assert_close(single.double(), exact, rtol=1e-4, atol=0)
