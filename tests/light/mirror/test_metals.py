"""What metals reflect."""

import math
import re

import numpy as np
import pytest
import torch

from torchbrdf.light.mirror import Metal
from torchbrdf.light.mirror.metals import fresnel


def test_straight_on_the_reflectance_is_the_closed_form():
    n, k = np.array([0.2, 1.5, 3.2]), np.array([3.1, 0.0, 3.3])
    expected = ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
    np.testing.assert_allclose(fresnel(np.ones(3), n, k), expected, rtol=1e-12)


def test_at_brewster_s_angle_glass_reflects_one_polarisation_alone():
    index = 1.5
    cosine = np.cos(np.arctan(index))
    across = ((cosine**2 - np.sin(np.arctan(index)) ** 2) / 1) ** 2
    assert fresnel(np.array([cosine]), np.array([index]), np.array([0.0]))[0] == pytest.approx(across / 2, rel=1e-9)


@pytest.mark.parametrize(("name", "low", "high"), [("Al", 0.9, 0.93), ("Cr", 0.55, 0.72), ("Ag", 0.9, 0.98)])
def test_metals_reflect_what_handbooks_say(name, low, high):
    """Of visible light, straight on: aluminium 0.91 to 0.92, chromium 0.55 to 0.7, silver 0.9 (blue) to 0.98."""
    straight = Metal.open(name).reflectance(torch.zeros(()))
    assert low < float(straight.min()) <= float(straight.max()) < high


def test_gold_is_yellow_and_all_reflect_everything_at_grazing():
    gold = Metal.open("Au").reflectance(torch.tensor([0.0, math.pi / 2]))
    assert float(gold[0, 0]) > 0.9 > float(gold[0, 1]) > 0.6 > float(gold[0, 2])
    torch.testing.assert_close(gold[1], torch.ones(3))


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("Chrome", "did you mean Cr?"),
        ("aluminun", "did you mean Al?"),
        ("cr", "did you mean Cr?"),
        ("Ni_palk", "did you mean Ni_palik or VN_palik?"),
        ("Ni", "did you mean Ni_palik?"),
        (
            "steel",
            "mirror balls are of Ag, Al, Au, Cr, Cu, Ni_palik; others are Be, Hg, Ir, K, Li, Mo, Na_palik, Nb, Rh, Se, "
            "Ta, Te, V_palik, W",
        ),
    ],
)
def test_an_unknown_metal_is_refused_with_what_may_be_meant(name, told):
    with pytest.raises(ValueError, match=f"^no metal '{name}' in Mitsuba's data; {re.escape(told)}$"):
        Metal.open(name)
