from math import pi

import pytest
import torch

from bsdf_cases import assert_agrees, numbers, rgb, some_geometry
from torchbrdf.analytic.catalogue import MODELS
from torchbrdf.analytic.fresnel import dielectric
from torchbrdf.analytic.models.rough_plastic import _sent_back, _sent_back_smoothly, _transmitted, rough_plastic

DIFFUSE, SPECULAR = (0.8, 0.4, 0.1), 0.9


@pytest.mark.parametrize(
    ("roughness", "eta"), [(0.003, 1.5), (0.05, 1.3), (0.1, 1.49), (0.3, 2.2), (0.7, 1.7), (1.0, 1.5)]
)
def test_it_is_mitsubas(mitsuba, roughness: float, eta: float):
    description = {"type": "roughplastic", "distribution": "ggx", "alpha": roughness, "int_ior": eta, "ext_ior": 1.0}
    description |= {"diffuse_reflectance": rgb(*DIFFUSE), "specular_reflectance": SPECULAR, "nonlinear": False}
    values = numbers(diffuse=DIFFUSE, specular=SPECULAR, eta=eta, roughness=roughness)
    assert_agrees(mitsuba, description, "rough-plastic", values)


def test_a_smooth_coat_transmits_what_it_does_not_reflect():
    eta, roughness = numbers(eta=1.5, roughness=1e-3).values()
    transmitted = _transmitted(eta, roughness)
    cosines = torch.linspace(0, 1, 64, dtype=torch.float64)[8:]
    torch.testing.assert_close(transmitted[0, 8:], 1 - dielectric(cosines, eta), rtol=1e-3, atol=0)


def test_a_smooth_coat_sends_back_60_percent_of_what_comes_from_below():
    """Internal diffuse reflectance of an index of 1.5: 0.596 [the classic value]; Mitsuba's table is 2 % below."""
    reflected = _sent_back(*numbers(eta=1.5, roughness=1e-3).values())
    assert float(reflected) == pytest.approx(0.596, abs=0.02)


def test_a_smooth_coat_of_index_near_1_leaves_the_base_alone():
    geometry = some_geometry()
    steep = ((geometry.cos_i > 0.3) & (geometry.cos_o > 0.3))[:, 0]
    f_r = rough_plastic(geometry, **numbers(diffuse=0.5, specular=0.0, eta=1.0001, roughness=0.02))[steep]
    torch.testing.assert_close(f_r, torch.full_like(f_r, 0.5 / pi), rtol=0.01, atol=0)


def test_derivatives_are_those_of_finite_differences():
    """To 5 %: those of what the coat sends back are of a smoother estimate."""
    geometry = some_geometry(6)
    at = [value.requires_grad_() for value in numbers(diffuse=0.5, specular=0.7, eta=1.45, roughness=0.35).values()]
    assert torch.autograd.gradcheck(lambda *values: rough_plastic(geometry, *values), at, rtol=5e-2)


@pytest.mark.parametrize("function", [_transmitted, _sent_back_smoothly])
def test_derivatives_of_the_coat_are_those_of_finite_differences(function):
    at = [value.requires_grad_() for value in numbers(eta=1.45, roughness=0.25).values()]
    assert torch.autograd.gradcheck(function, at)


@pytest.mark.parametrize(("eta", "roughness"), [(1.3, 0.05), (1.5, 0.15), (1.5, 0.5), (1.9, 0.3)])
def test_the_smooth_estimate_is_near_the_sum(eta: float, roughness: float):
    at = numbers(eta=eta, roughness=roughness).values()
    torch.testing.assert_close(_sent_back_smoothly(*at), _sent_back(*at), rtol=1e-3, atol=1e-4)


def test_a_batch_is_its_parts_and_channels_may_have_a_roughness_each():
    geometry = some_geometry(10)
    eta = torch.tensor([[1.3], [1.6]], dtype=torch.float64)
    roughness = torch.tensor([[0.1, 0.2, 0.4], [0.5, 0.3, 0.05]], dtype=torch.float64)
    model, fixed = MODELS["rough-plastic"], numbers(diffuse=DIFFUSE, specular=SPECULAR)
    repeated = {name: value.expand(2, -1) for name, value in fixed.items()}
    both = model.evaluate({**repeated, "eta": eta, "roughness": roughness}, geometry)
    for index in range(2):
        alone = model.evaluate({**fixed, "eta": eta[index], "roughness": roughness[index]}, geometry)
        torch.testing.assert_close(both[index], alone)
        for channel in range(3):
            grey = {**fixed, "eta": eta[index], "roughness": roughness[index, channel : channel + 1]}
            torch.testing.assert_close(both[index, :, channel], model.evaluate(grey, geometry)[:, channel])
