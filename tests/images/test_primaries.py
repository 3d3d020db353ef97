"""Conversions between linear RGB spaces, against published matrices."""

import itertools

import numpy as np
import pytest
import torch

from torchbrdf.images.primaries import SPACES, Primaries, conversion, converted

REC709_WHITE = (0.3127, 0.3290)

TO_XYZ = {
    "rec709": [[0.41246, 0.35758, 0.18044], [0.21267, 0.71515, 0.07217], [0.01933, 0.11919, 0.95030]],
    "rec2020": [[0.63696, 0.14462, 0.16888], [0.26270, 0.67800, 0.05930], [0.0, 0.02807, 1.06099]],
    "aces-ap0": [[0.95255, 0.0, 0.00009], [0.34397, 0.72817, -0.07213], [0.0, 0.0, 1.00883]],
    "aces-ap1": [[0.66245, 0.13400, 0.15619], [0.27223, 0.67408, 0.05369], [-0.00557, 0.00406, 1.01034]],
    "xyz": np.eye(3),
}
"""Lindbloom for sRGB, ITU-R BT.2087 for Rec. 2020, SMPTE ST 2065-1 and S-2014-004 for ACES."""

CONVERSIONS = {
    ("rec2020", "rec709"): [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]],
    ("p3-d65", "rec709"): [[1.2249, -0.2249, 0.0], [-0.0421, 1.0421, 0.0], [-0.0196, -0.0786, 1.0983]],
    ("aces-ap1", "aces-ap0"): [[0.69545, 0.14068, 0.16387], [0.04479, 0.85967, 0.09553], [-0.00553, 0.00403, 1.0015]],
    ("aces-ap0", "rec709"): [[2.5217, -1.1341, -0.3876], [-0.2765, 1.3727, -0.0962], [-0.0154, -0.1530, 1.1683]],
    ("aces-ap1", "rec709"): [[1.7051, -0.6218, -0.0833], [-0.1303, 1.1408, -0.0105], [-0.0240, -0.1290, 1.1530]],
}
"""ITU-R BT.2407 and the ACES transforms, whose whites are adapted by Bradford's transform."""


@pytest.mark.parametrize("name", TO_XYZ)
def test_spaces_in_xyz(name):
    np.testing.assert_allclose(SPACES[name].to_xyz(), TO_XYZ[name], atol=1e-3)


@pytest.mark.parametrize(("source", "target"), CONVERSIONS)
def test_published_conversions(source, target):
    np.testing.assert_allclose(conversion(SPACES[source], SPACES[target]), CONVERSIONS[source, target], atol=1e-3)


def test_bradford_from_d65_to_d50():
    primaries = SPACES["xyz"].values[:3]
    d65, d50 = Primaries(*primaries, REC709_WHITE), Primaries(*primaries, (0.3457, 0.3585))
    adapted = d50.to_xyz() @ conversion(d65, d50) @ np.linalg.inv(d65.to_xyz())
    published = [[1.0478, 0.0229, -0.0501], [0.0295, 0.9905, -0.0170], [-0.0092, 0.0150, 0.7521]]
    np.testing.assert_allclose(adapted, published, atol=1e-3)


@pytest.mark.parametrize(("source", "target"), list(itertools.permutations(SPACES, 2)))
def test_white_stays_white_and_there_is_a_way_back(source, target):
    there, back = conversion(SPACES[source], SPACES[target]), conversion(SPACES[target], SPACES[source])
    np.testing.assert_allclose(there @ np.ones(3), np.ones(3), atol=1e-12)
    np.testing.assert_allclose(back @ there, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("numbers", "name"),
    [
        ((0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.313, 0.329), "rec709"),
        ((0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.31271, 0.32902), "rec709"),
        ((0.6484, 0.3309, 0.3212, 0.5979, 0.1559, 0.0661, 0.3457, 0.3585), "rec709"),  # as sRGB profiles name it
        ((0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.322, 0.338), "aces-ap1"),
        ((0.64, 0.33, 0.29, 0.60, 0.15, 0.06, 0.333, 0.333), None),  # of Radiance
        ((0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.329), None),  # Adobe RGB
    ],
)
def test_rounded_chromaticities_name_their_space(numbers, name):
    said = str(Primaries.of(numbers))
    assert said == name if name else said.startswith("primaries (0.64 0.33), (0.2")


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ((0.64, 0.33, 0.64, 0.33, 0.15, 0.06, 0.3127, 0.329), "span no colour space"),
        ((0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.7, 0.29), "span no colour space around their white"),
        ((0.0,) * 8, "with a white above 0"),
        ((float("nan"),) * 8, "must be finite"),
        ((1e30, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.329), "must be finite"),
    ],
)
def test_chromaticities_that_span_no_space(numbers, message):
    with pytest.raises(ValueError, match=message):
        Primaries.of(numbers)


@pytest.mark.parametrize("spaces", [("srgb", "rec709"), ("rec709", "srgb"), ("srgb", "srgb")])
def test_colours_of_a_space_that_is_none(spaces):
    message = r"^primaries must be one of rec709, rec2020, p3-d65, aces-ap0, aces-ap1, xyz, got 'srgb'$"
    with pytest.raises(ValueError, match=message):
        converted(torch.ones(3, 2, 2), *spaces)
