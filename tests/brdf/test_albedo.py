from math import cos, pi

import pytest
import torch

from torchbrdf.brdf.albedo import ALBEDO_DEG, albedo_of, albedo_rule, directional_albedo, reflects_too_much
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.brdf.merl_grid import GRID


@pytest.mark.parametrize("degrees", [0.0, 20.0, 45.0, 70.0, 85.0, 89.0])
def test_a_closed_form_of_two_directions(degrees: float):
    """f_r = cos(theta_d)^2 = (1 + w_i . w_o) / 2, times cos(theta_i), integrates to pi / 2 + pi cos(theta_o) / 3."""
    cells, weights = albedo_rule(degrees * pi / 180)
    theta_d = (cells // GRID[2] % GRID[1] + 0.5) / GRID[1] * (pi / 2)
    expected = pi / 2 + pi * cos(degrees * pi / 180) / 3
    assert float(weights @ torch.cos(theta_d.double()) ** 2) == pytest.approx(expected, rel=2e-3)
    assert float(weights.sum()) == pytest.approx(pi, rel=1e-12)


def test_lambert_reflects_its_albedo_from_everywhere(tiny_tables: dict[str, MerlTable]):
    expected = torch.tensor([0.8, 0.8, 0.75], dtype=torch.float64).expand(len(ALBEDO_DEG), 3)
    assert torch.allclose(directional_albedo(tiny_tables["white"]), expected, rtol=1e-12)


def test_of_many_columns_it_is_that_of_each_table(tiny_tables: dict[str, MerlTable]):
    tables = [tiny_tables["white"], tiny_tables["red"]]
    both = torch.cat([table.filled for table in tables], 1)
    expected = torch.cat([directional_albedo(table) for table in tables], 1)
    assert torch.equal(albedo_of(both.__getitem__), expected)


def test_too_much_says_how_much_from_where():
    albedo = torch.tensor([[0.5, 0.9], [0.1, 1.5], [1.6, 0.3], [1.2, 1.1]])
    assert reflects_too_much(albedo) == "reflects 1.60 times the light that comes in at 60°"
    assert reflects_too_much(albedo.double() * 1e200) == "reflects 1.6e+200 times the light that comes in at 60°"


@pytest.mark.parametrize(("albedo", "much"), [(1.01, 1.02), (1.5, 2.0)])
def test_what_is_not_much_is_not_said(albedo: float, much: float):
    assert reflects_too_much(torch.full((4,), albedo), much) is None
