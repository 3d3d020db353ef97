from math import pi, sqrt

import numpy as np
import pytest
import torch
from torch import Tensor

from bsdf_cases import assert_agrees, direction_pairs, numbers, rgb, some_geometry
from torchbrdf.analytic.catalogue import MODELS
from torchbrdf.analytic.microfacet import beckmann_distribution, ggx_distribution, ggx_visibility, v_groove_visibility
from torchbrdf.analytic.shading_geometry import ShadingGeometry

HEAD_ON = ShadingGeometry.of_angles(*torch.zeros(3, 1, dtype=torch.float64))


def number(value: float) -> Tensor:
    return torch.tensor([value], dtype=torch.float64)


@pytest.mark.parametrize("distribution", [ggx_distribution, beckmann_distribution])
@pytest.mark.parametrize("roughness", [0.001, 0.03, 0.4, 1.0])
def test_distributions_integrate_to_one(distribution, roughness: float):
    nodes, weights = map(torch.from_numpy, np.polynomial.legendre.leggauss(100))
    tangent = roughness * torch.tan((nodes + 1) * pi / 4)  # stretched, so that the peak is resolved
    theta = torch.atan(tangent)
    step = roughness * (pi / 4) / torch.cos((nodes + 1) * pi / 4) ** 2 / (1 + tangent**2)
    geometry = ShadingGeometry.of_angles(theta, torch.zeros_like(theta), torch.zeros_like(theta))
    integrand = distribution(geometry, number(roughness))[:, 0] * torch.cos(theta) * torch.sin(theta) * 2 * pi
    assert float((integrand * step * weights).sum()) == pytest.approx(1, rel=1e-6)


def test_head_on_values():
    m, white = 0.2, (0.3, 0.2, 0.1)
    peak = 1 / (4 * pi * m**2)
    diffuse = torch.tensor(white, dtype=torch.float64) / pi

    def at(name: str, **values: float) -> Tensor:
        return MODELS[name].evaluate(numbers(diffuse=white, **values), HEAD_ON)[0] - diffuse

    same = torch.ones(3, dtype=torch.float64)
    torch.testing.assert_close(at("ggx", specular=0.5, roughness=m), 0.5 * peak * same)
    torch.testing.assert_close(at("ggx-dielectric", specular=0.5, eta=1.5, roughness=m), 0.5 * 0.04 * peak * same)
    torch.testing.assert_close(at("cook-torrance", specular=0.5, f0=0.3, roughness=m), 0.15 * peak * same)
    exact = at("cook-torrance-dielectric", specular=0.5, eta=1.5, roughness=m)
    torch.testing.assert_close(exact, 0.5 * 0.04 * peak * same)
    low = at("low-microfacet", amplitude=7.0, width=123.0, decay=1.2, eta=1.5)
    torch.testing.assert_close(low, 7 * 0.04 * same)


def test_the_metal_reflects_head_on_what_its_index_says():
    f0 = ((0.2 - 1) ** 2 + 3.9**2) / ((0.2 + 1) ** 2 + 3.9**2)
    f_r = MODELS["rough-conductor"].evaluate(numbers(eta=0.2, k=3.9, roughness=0.1), HEAD_ON)
    assert float(f_r[0, 0]) == pytest.approx(f0 / (4 * pi * 0.01), rel=1e-9)


def test_lows_fall_is_half_where_it_must_be():
    """1 + B (1 - cos) = 2 halves S for C = 1; the factors F and G / cos cos are those of the same pair with C = 0."""
    width = 40.0
    theta = torch.acos(torch.tensor([1 - 1 / width], dtype=torch.float64))
    geometry = ShadingGeometry.of_angles(theta, torch.tensor([0.1]).double(), torch.tensor([pi / 2]).double())

    def at(decay: float) -> Tensor:
        values = numbers(diffuse=0.0, amplitude=3.0, width=width, decay=decay, eta=1.5)
        return MODELS["low-microfacet"].evaluate(values, geometry)

    torch.testing.assert_close(at(1.0), at(0.0) / 2)
    torch.testing.assert_close(at(3.0), at(0.0) / 8)


def test_v_grooves_are_those_of_the_paper():
    w_i, w_o = direction_pairs(500, seed=3)
    h = torch.nn.functional.normalize(w_i + w_o, dim=-1)
    n_h, n_i, n_o, i_h = h[:, 2], w_i[:, 2], w_o[:, 2], (w_i * h).sum(-1)
    g = torch.stack([torch.ones_like(n_h), 2 * n_h * n_i / i_h, 2 * n_h * n_o / i_h]).amin(0)
    ours = v_groove_visibility(ShadingGeometry.of_directions(w_i, w_o))[:, 0]
    torch.testing.assert_close(ours, g / (4 * n_i * n_o), rtol=1e-5, atol=0)


def test_smith_shadows_half_of_a_rough_surface_at_60_degrees():
    """G1 = 2 / (1 + sqrt(1 + alpha^2 tan^2)): with alpha = sqrt(8/3) tan = sqrt(3) makes the root 3."""
    angle = torch.tensor([pi / 3], dtype=torch.float64)
    mirror = ShadingGeometry.of_angles(torch.zeros_like(angle), angle, torch.zeros_like(angle))
    visibility = ggx_visibility(mirror, number(sqrt(8 / 3)))
    assert float(visibility) == pytest.approx(0.5 * 0.5 / (4 * 0.5 * 0.5))


def test_the_two_ggx_with_one_f_are_one():
    """Schlick's F is the exact one at normal incidence, theta_d = 0."""
    angle = torch.linspace(0, 1.2, 30, dtype=torch.float64)
    geometry = ShadingGeometry.of_angles(angle, torch.zeros_like(angle), torch.zeros_like(angle))
    exact = MODELS["ggx-dielectric"].evaluate(numbers(diffuse=0.2, specular=1.0, eta=1.5, roughness=0.3), geometry)
    usual = MODELS["ggx"].evaluate(numbers(diffuse=0.2, specular=0.04, roughness=0.3), geometry)
    torch.testing.assert_close(exact, usual)


@pytest.mark.parametrize("roughness", [0.02, 0.15, 0.6])
def test_rough_conductor_is_mitsubas(mitsuba, roughness: float):
    eta, k = (0.2, 0.92, 1.1), (3.9, 2.45, 2.14)
    description = {"type": "roughconductor", "distribution": "ggx", "alpha": roughness, "eta": rgb(*eta), "k": rgb(*k)}
    assert_agrees(mitsuba, description, "rough-conductor", numbers(eta=eta, k=k, roughness=roughness))


@pytest.mark.parametrize(("roughness", "eta"), [(0.05, 1.3), (0.3, 1.5), (0.8, 2.0)])
def test_ggx_with_the_exact_f_is_mitsubas_plastic_without_a_base(mitsuba, roughness: float, eta: float):
    description = {"type": "roughplastic", "distribution": "ggx", "alpha": roughness, "int_ior": eta, "ext_ior": 1.0}
    description |= {"diffuse_reflectance": 0.0, "specular_reflectance": rgb(0.9, 0.5, 0.2)}
    values = numbers(diffuse=0.0, specular=(0.9, 0.5, 0.2), eta=eta, roughness=roughness)
    assert_agrees(mitsuba, description, "ggx-dielectric", values)


@pytest.mark.parametrize("roughness", [0.05, 0.4])
def test_cook_torrance_with_mitsubas_beckmann(mitsuba, roughness: float):
    """Mitsuba's Beckmann with its Smith G taken out: what is left is D F / (4 cos cos), as here without V-grooves."""
    w_i, w_o = direction_pairs(1000, seed=4)
    geometry = ShadingGeometry.of_directions(w_i, w_o)
    distribution = mitsuba.MicrofacetDistribution(mitsuba.MicrofacetType.Beckmann, roughness)
    h = torch.nn.functional.normalize(w_i + w_o, dim=-1)
    theirs = np.array(distribution.eval(mitsuba.Vector3f(*h.T.numpy().astype(np.float32))))
    ours = beckmann_distribution(geometry, number(roughness))[:, 0]
    torch.testing.assert_close(ours, torch.from_numpy(theirs).double(), rtol=2e-4, atol=1e-6)


def test_single_precision_is_near_double_precision():
    geometry = some_geometry(400, seed=8)
    for name, values in {
        "ggx": numbers(diffuse=0.1, specular=0.3, roughness=0.01),
        "cook-torrance": numbers(diffuse=0.1, specular=1.0, f0=0.3, roughness=0.02),
        "low-microfacet": numbers(diffuse=0.1, amplitude=100.0, width=3e4, decay=1.3, eta=1.4),
    }.items():
        exact = MODELS[name].evaluate(values, geometry)
        single = MODELS[name].evaluate({k: v.float() for k, v in values.items()}, geometry.to(torch.float32))
        torch.testing.assert_close(single.double(), exact, rtol=1e-4, atol=1e-6, msg=name)
