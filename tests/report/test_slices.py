import base64
import re
from math import log2, pi

import cv2
import numpy as np
import pytest
import torch

from materials import glossy, lambert
from torchbrdf.brdf.directions import from_half_difference
from torchbrdf.brdf.merl import MerlTable, cell_centres
from torchbrdf.report._slices import slice_exposures, slice_figure, slice_values


@pytest.fixture(scope="module")
def paint():
    return MerlTable.from_function(glossy((0.3, 0.08, 0.05), (0.06, 0.06, 0.06), 0.14), "paint")


def shown(figure):
    data = base64.b64decode(re.search(r'base64,([^"]*)"', figure)[1])
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)[..., ::-1] / 255.0


def test_the_slice_of_a_known_brdf(paint):
    values, measured = slice_values(paint)
    theta_h, theta_d, _ = cell_centres()
    w_i, w_o = from_half_difference(theta_h, theta_d, torch.tensor([pi / 2]).double())
    expected = glossy((0.3, 0.08, 0.05), (0.06, 0.06, 0.06), 0.14)(w_i, w_o)[:, :, 0].permute(2, 1, 0).flip(1)
    assert values.shape == (3, 90, 90)
    inside = values[:, 5:, :85]
    assert torch.allclose(inside, expected[:, 5:, :85], rtol=0.02)
    assert measured.all()
    assert values[0, 89, 0] == values[0, 89].max(), "the highlight is not at the left"
    assert values[1, 0, 0] > 2 * values[1, 89, 0], "grazing angles are not at the top"


def test_the_picture_and_its_stripes():
    paint = MerlTable.from_function(glossy((0.3, 0.08, 0.05), (0.3, 0.3, 0.3), 0.06), "gloss")
    beside, peak = slice_exposures(paint)
    assert log2(beside).is_integer()
    assert log2(peak).is_integer()
    assert peak < beside
    picture = shown(slice_figure(paint, "<b>x</b>", peak))
    assert picture.shape == (270, 270, 3)
    expected = (slice_values(paint)[0] * peak).clamp(0, 1).permute(1, 2, 0).numpy() ** (1 / 2.2)
    assert np.abs(picture[1::3, 1::3] - expected).max() < 0.6 / 255
    assert 0.8 < np.median(picture[:, 0].max(-1)) <= 1

    valid = paint.valid.clone()
    valid[:, 30:45, 80:100] = False
    holes = MerlTable(torch.where(valid[..., None], paint.values, float("nan")), valid)
    assert not slice_values(holes)[1][0, 45:60].any()
    assert slice_values(holes)[1].sum() == 75 * 90
    figure = slice_figure(holes, "", beside)
    assert "White: f<sub>r</sub> = " in figure
    stripes = shown(figure)[135:180]
    assert {round(float(v), 2) for v in stripes.ravel()} == {0.36, 0.56}
    assert np.abs(shown(figure)[180:] - shown(slice_figure(paint, "", beside))[180:]).max() < 1 / 255


def test_one_measured_half_is_enough():
    table = MerlTable.from_function(lambert(0.5, 0.5, 0.5))
    valid, values = table.valid.clone(), table.values.clone()
    valid[40, 40, 90], values[40, 40, 90], values[40, 40, 89] = False, float("nan"), 7.0
    found, measured = slice_values(MerlTable(values, valid))
    assert measured.all()
    assert found[:, 49, 40].tolist() == [7.0, 7.0, 7.0]


def test_black():
    black = MerlTable.from_function(lambert(0.0, 0.0, 0.0))
    assert slice_exposures(black) == (1.0, 1.0)
    assert not shown(slice_figure(black, "", 1.0)).any()
