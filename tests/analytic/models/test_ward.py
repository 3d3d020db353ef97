from math import pi

import pytest
import torch

from bsdf_cases import albedo, numbers, some_geometry
from torchbrdf.analytic.catalogue import MODELS
from torchbrdf.analytic.models.ward import ward
from torchbrdf.analytic.models.ward_bounded import ward_bounded
from torchbrdf.analytic.models.ward_duer import ward_duer
from torchbrdf.analytic.shading_geometry import ShadingGeometry

VARIANTS = ["ward", "ward-duer", "ward-bounded"]


@pytest.mark.parametrize("name", VARIANTS)
def test_head_on_all_have_the_same_peak(name: str):
    head_on = ShadingGeometry.of_angles(*torch.zeros(3, 1, dtype=torch.float64))
    f_r = MODELS[name].evaluate(numbers(diffuse=0.3, specular=0.2, roughness=0.1), head_on)
    expected = torch.full((1, 3), 0.3 / pi + 0.2 / (4 * pi * 0.01), dtype=torch.float64)
    torch.testing.assert_close(f_r, expected)


@pytest.mark.parametrize("name", VARIANTS)
def test_a_narrow_lobe_reflects_its_specular_head_on(name: str):
    reflected = albedo(name, numbers(diffuse=0.0, specular=0.6, roughness=0.05), 1.0)
    torch.testing.assert_close(reflected, torch.full((3,), 0.6, dtype=torch.float64), rtol=0.02, atol=0)


def test_they_differ_by_what_they_divide_by():
    geometry = some_geometry()
    values = numbers(diffuse=0.0, specular=1.0, roughness=0.3)
    both = geometry.cos_i * geometry.cos_o
    lobe = ward_duer(geometry, **values) * both
    torch.testing.assert_close(ward(geometry, **values) * both.sqrt(), lobe)
    third = geometry.cos_d.square() * geometry.cos_h**4
    torch.testing.assert_close(ward_bounded(geometry, **values) * third, lobe)


def test_at_grazing_angles_ward_loses_duer_has_no_bound_and_the_bounded_one_keeps_it():
    values = numbers(diffuse=0.0, specular=1.0, roughness=0.2)
    shares = {name: float(albedo(name, values, 0.02)[0]) for name in VARIANTS}
    assert shares["ward"] < 0.5
    assert shares["ward-duer"] > 2
    assert 0.5 < shares["ward-bounded"] < 1


@pytest.mark.parametrize("roughness", [0.05, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("cosine", [1.0, 0.5, 0.05])
def test_the_bounded_variant_reflects_no_more_than_its_specular(roughness: float, cosine: float):
    assert float(albedo("ward-bounded", numbers(diffuse=0.0, specular=1.0, roughness=roughness), cosine)[0]) < 1
