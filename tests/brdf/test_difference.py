import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from materials import glossy, lambert
from torchbrdf.brdf.difference import BRDFDifference, cell_difference, delta_e_2000
from torchbrdf.brdf.merl import MerlTable

# Lab pairs and CIEDE2000 of [SWD05, table 1], those inside the gamut of sRGB.
PUBLISHED = [
    ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ((63.0109, -31.0961, -5.8663), (62.8187, -29.7946, -4.0864), 1.2630),
    ((61.2901, 3.7196, -5.3901), (61.4292, 2.2480, -4.9620), 1.8731),
    ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
    ((36.4612, 47.8580, 18.3852), (36.2715, 50.5065, 21.2231), 1.4146),
    ((90.8027, -2.0831, 1.4410), (91.1528, -1.6435, 0.0447), 1.4441),
    ((6.7747, -0.2908, -2.4247), (5.8714, -0.0985, -2.2286), 0.6377),
]
TO_RGB = np.array(  # IEC 61966-2-1: XYZ of D65 to linear sRGB
    [[3.2406255, -1.537208, -0.4986286], [-0.9689307, 1.8757561, 0.0415175], [0.0557101, -0.2040211, 1.0569959]]
)


def linear_rgb(lightness, a, b):
    y = (lightness + 16) / 116
    roots = np.array([y + a / 500, y, y - b / 200])
    xyz = np.where(roots > 6 / 29, roots**3, 3 * (6 / 29) ** 2 * (roots - 4 / 29)) * (0.95047, 1.0, 1.08883)
    return TO_RGB @ xyz


@pytest.fixture(scope="module")
def paint():
    return MerlTable.from_function(glossy((0.3, 0.08, 0.05), (0.06, 0.06, 0.06), 0.14), "paint")


def test_a_scaled_brdf(paint):
    brighter = replace(paint, values=1.1 * paint.values)
    assert cell_difference(brighter, paint, "l2") == pytest.approx(0.1, rel=1e-9)
    assert cell_difference(brighter, paint, "cube-root") == pytest.approx(1.1 ** (1 / 3) - 1, rel=0.01)
    assert cell_difference(brighter, paint, "log") < 0.1
    assert cell_difference(paint, paint, "log") == 0


@pytest.mark.parametrize("metric", ["l2", "log", "cube-root"])
def test_two_lambertian_brdfs(metric):
    """cos(theta_i) is uniform on [0, 1] in dw_i dw_o, so both norms are integrals over it."""
    a, b = 0.9 / math.pi, 0.4 / math.pi
    tables = [MerlTable.from_function(lambert(albedo, albedo, albedo)) for albedo in (0.9, 0.4)]
    c = (np.arange(200_000) + 0.5) / 200_000
    mapped = {"l2": lambda x: x, "log": np.log1p, "cube-root": lambda x: np.cbrt(x)}[metric]
    expected = math.sqrt(np.mean((mapped(a * c) - mapped(b * c)) ** 2) / np.mean(mapped(b * c) ** 2))
    assert cell_difference(*tables, metric) == pytest.approx(expected, rel=2e-2 if metric == "cube-root" else 1e-3)


def test_the_three_channels_count_alike():
    one, other = (MerlTable.from_function(lambert(*albedo)) for albedo in ((0.5, 0.5, 0.9), (0.5, 0.5, 0.4)))
    assert cell_difference(one, other, "l2") == pytest.approx(0.5 / math.sqrt(0.25 + 0.25 + 0.16), rel=1e-9)


def test_only_cells_that_both_measured_count(paint):
    valid = paint.valid.clone()
    valid[:30] = False
    values = torch.where(valid[..., None], paint.values, float("nan"))
    holes = MerlTable(values, valid, "holes")
    assert cell_difference(holes, paint, "l2") == 0
    assert cell_difference(paint, holes, "cube-root") == 0
    rest = MerlTable(paint.values, ~valid & paint.valid, "rest")
    for metric in ("l2", "log"):
        with pytest.raises(ValueError, match="holes and rest: no cell was measured in both, so nothing can be comp"):
            cell_difference(holes, rest, metric)


def test_a_black_reference_has_no_relative_difference(paint):
    black = replace(paint, values=0 * paint.values)
    assert cell_difference(paint, black, "log") == math.inf
    assert cell_difference(black, black, "l2") == 0
    assert cell_difference(black, paint, "l2") == 1
    negative = replace(paint, values=torch.full_like(paint.values, -3.0))
    assert cell_difference(negative, paint, "cube-root") == 1


def test_an_unknown_metric(paint):
    with pytest.raises(ValueError, match="metric must be one of l2, log, cube-root, got 'cosine'"):
        cell_difference(paint, paint, "cosine")


@pytest.mark.parametrize("exposure", [1.0, 8.0])
def test_published_colour_differences(exposure):
    one, other = (
        torch.from_numpy(np.array([linear_rgb(*pair[i]) for pair in PUBLISHED]).T[:, None] / exposure) for i in (0, 1)
    )
    assert 0 <= one.min() <= one.max() < 1 / exposure, "a colour lies outside the gamut"
    expected = [difference for _, _, difference in PUBLISHED]
    assert delta_e_2000(one, other, exposure)[0].tolist() == pytest.approx(expected, abs=2e-3)
    assert delta_e_2000(other, one, exposure)[0].tolist() == pytest.approx(expected, abs=2e-3)


def test_what_is_beyond_white_looks_white():
    white, grey = torch.ones(3, 2, 2), torch.full((3, 2, 2), 0.5)
    assert float(delta_e_2000(9 * white, white).max()) == pytest.approx(0, abs=1e-12)
    assert float(delta_e_2000(white, grey, 2.0).max()) == pytest.approx(0, abs=1e-12)
    assert float(delta_e_2000(white, 0 * white)[0, 0]) == pytest.approx(100, abs=0.01)
    with pytest.raises(ValueError, match=r"images must have equal shapes \(3, H, W\), got \(3, 2, 2\) and \(1, 2, 2\)"):
        delta_e_2000(white, white[:1])


def test_the_difference_of_pictures(paint):
    generator = torch.Generator().manual_seed(0)
    reference = torch.rand(3, 40, 40, generator=generator)
    image = reference.clone()
    image[:, 0] *= 0.5
    image[:, 5] = 7.0
    mask = torch.ones(1, 40, 40, dtype=torch.bool)
    mask[0, 5] = False
    found = BRDFDifference.of(paint, paint, (image, reference), mask, 0.5)
    assert dict(found.cells) == {"l2": 0, "log": 0, "cube-root": 0}
    assert found.common == pytest.approx(1, abs=1e-12)
    used = reference[:, [i for i in range(40) if i != 5]]
    assert found.picture == pytest.approx(0.5 * float(reference[:, 0].norm() / used.norm()), rel=1e-6)
    colours = delta_e_2000(image, reference, 0.5)[0]
    assert found.delta_e_mean == pytest.approx(float(colours.sum()) / (39 * 40), rel=1e-9)
    assert found.delta_e_95 == 0
    dark = BRDFDifference.of(paint, paint, (image, 0 * reference), mask, 0.5)
    assert (dark.picture, BRDFDifference.of(paint, paint, (0 * image, 0 * image), mask, 1.0).picture) == (math.inf, 0)
