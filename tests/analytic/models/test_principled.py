from math import pi
from typing import Any

import pytest
import torch

from bsdf_cases import assert_agrees, numbers, rgb, some_geometry
from torchbrdf.analytic.catalogue import MODELS
from torchbrdf.analytic.fresnel import normal_incidence
from torchbrdf.analytic.models.principled import LUMINANCE, index_of, tint_of

BASE: dict[str, Any] = {
    "base_color": (0.8, 0.3, 0.1),
    "roughness": 0.4,
    "metallic": 0.0,
    "specular": 0.5,
    "spec_tint": 0.0,
    "sheen": 0.0,
    "sheen_tint": 0.0,
    "flatness": 0.0,
    "clearcoat": 0.0,
    "clearcoat_gloss": 0.4,
}

CASES: list[dict[str, Any]] = [
    {},
    {"roughness": 0.1},
    {"roughness": 1.0},
    {"specular": 0.05},
    {"metallic": 0.7},
    {"metallic": 1.0, "roughness": 0.2},
    {"spec_tint": 0.6},
    {"sheen": 0.8},
    {"sheen": 0.8, "sheen_tint": 0.3},
    {"flatness": 0.7},
    {"clearcoat": 0.9},
    {"clearcoat": 0.9, "clearcoat_gloss": 0.0},
    {
        "roughness": 0.2,
        "metallic": 0.3,
        "specular": 0.8,
        "spec_tint": 0.4,
        "sheen": 0.3,
        "sheen_tint": 0.6,
        "flatness": 0.3,
        "clearcoat": 0.4,
        "clearcoat_gloss": 0.3,
    },
]


@pytest.mark.parametrize("changes", CASES, ids=str)
def test_it_is_mitsubas(mitsuba, changes: dict[str, Any]):
    """Up to a clearcoat_gloss of 0.5: above, Mitsuba's clear coat loses digits in single precision."""
    values = BASE | changes
    description = {name: value for name, value in values.items() if value != 0}
    description |= {"type": "principled", "base_color": rgb(*values["base_color"])}
    assert_agrees(mitsuba, description, "principled", numbers(**values))


def test_a_glossy_clear_coat_is_mitsubas_as_far_as_its_digits_go(mitsuba):
    values = BASE | {"clearcoat": 0.9, "clearcoat_gloss": 0.8}
    description = {name: value for name, value in values.items() if value != 0}
    description |= {"type": "principled", "base_color": rgb(*values["base_color"])}
    assert_agrees(mitsuba, description, "principled", numbers(**values), rtol=1e-3)


def test_specular_is_the_reflectance_of_a_dielectric_over_8_percent():
    specular = torch.tensor([0.001, 0.5, 1.0], dtype=torch.float64)
    torch.testing.assert_close(normal_incidence(index_of(specular)), 0.08 * specular)


def test_a_tint_keeps_the_colour_and_has_luminance_one():
    tint = tint_of(torch.tensor([0.4, 0.2, 0.1], dtype=torch.float64))
    assert float((tint * torch.tensor(LUMINANCE)).sum()) == pytest.approx(1)
    torch.testing.assert_close(tint / tint[2], torch.tensor([4.0, 2.0, 1.0], dtype=torch.float64))
    torch.testing.assert_close(tint_of(torch.zeros(3)), torch.ones(3))
    torch.testing.assert_close(tint_of(torch.tensor([0.3])), torch.ones(1))


def test_a_grey_of_one_number_is_that_of_three():
    values = numbers(**BASE | {"base_color": 0.3, "spec_tint": 0.5, "sheen": 0.5, "sheen_tint": 0.5})
    three = {**values, "base_color": values["base_color"].expand(3)}
    geometry = some_geometry()
    model = MODELS["principled"]
    torch.testing.assert_close(model.evaluate(values, geometry), model.evaluate(three, geometry))


def test_a_tinted_lobe_couples_the_channels():
    """A channel depends on the others through the luminance of the colour: only with a tint."""
    geometry = some_geometry()
    for tint, moves in ((0.0, False), (0.5, True)):
        values = numbers(**BASE | {"spec_tint": tint})
        bluer = {**values, "base_color": torch.tensor([0.8, 0.3, 0.6], dtype=torch.float64)}
        change = MODELS["principled"].evaluate(bluer, geometry) - MODELS["principled"].evaluate(values, geometry)
        assert bool(change[:, 0].abs().max() > 1e-6) is moves


def test_the_colour_black_has_finite_gradients():
    values = {name: value.requires_grad_() for name, value in numbers(**BASE | {"base_color": (0.0, 0.0, 0.0)}).items()}
    values["spec_tint"] = torch.tensor([0.5], dtype=torch.float64, requires_grad=True)
    MODELS["principled"].evaluate(values, some_geometry()).sum().backward()
    assert all(value.grad.isfinite().all() for value in values.values())


def test_a_rough_white_surface_reflects_about_what_comes_in():
    values = numbers(**BASE | {"base_color": (1.0, 1.0, 1.0), "roughness": 0.5, "specular": 0.001})
    f_r = MODELS["principled"].evaluate(values, some_geometry(400))
    assert 0.5 / pi < float(f_r[200:].median()) < 1.2 / pi
