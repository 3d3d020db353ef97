"""Doubts about a result: without a report the same as in it, but for what needs pictures; shares that count."""

import pytest
import torch

from torchbrdf.brdf.merl import MerlTable
from torchbrdf.estimation.classes import MaterialClasses
from torchbrdf.estimation.estimator import BRDFEstimator
from torchbrdf.light.probe import LightProbe
from torchbrdf.rendering.basis import render_basis
from torchbrdf.report.doubts import (
    DARK_MIDDLE,
    ClassShare,
    clamped_share,
    darkest_middle,
    doubts,
    doubts_of_result,
    doubts_without_pictures,
)
from torchbrdf.report.evidence import Subject, gather
from torchbrdf.view.sphere import SphereView


@pytest.mark.parametrize("penalty", ["auto", 0.0])
def test_without_a_report_they_are_those_of_the_report(tiny_library, penalty):
    """Of a photograph that nothing explains, too bright for any material."""
    probe, view = LightProbe.default(32), SphereView(12)
    basis = render_basis(tiny_library, probe, view, samples=64)
    photograph = 60 * torch.rand(3, 12, 12, generator=torch.Generator().manual_seed(0)) * view.mask
    result = BRDFEstimator(basis, MaterialClasses.fit(tiny_library, n_classes=2, n_dims=2), penalty)(photograph)
    expected = gather(Subject(photograph, view.mask, result, basis, tiny_library, probe, view), 8, 8).found_doubts
    found = doubts_without_pictures(result, basis, result.brdf(tiny_library))
    assert len(found) > 1
    assert found == [doubt for doubt in expected if doubt.topic != "uncertain"]
    assert doubts_of_result(result, basis, result.brdf(tiny_library)) == [str(doubt) for doubt in found]


@pytest.mark.parametrize(("scale", "topic"), [(1, None), (1e-5, "too-dark"), (1e3, "too-bright")])
def test_units_that_differ_show_in_how_much_is_reflected(tiny_library, scale, topic):
    basis = render_basis(tiny_library, LightProbe.default(32), SphereView(12), samples=64)
    result = BRDFEstimator(basis, MaterialClasses.single(tiny_library))(scale * basis.image("white"))
    found = {doubt.topic for doubt in doubts_without_pictures(result, basis, result.brdf(tiny_library))}
    assert found & {"too-dark", "too-bright"} == ({topic} if topic else set())


@pytest.mark.parametrize(("error", "told"), [(0.01, "are in different units; scale"), (0.3, "of another light, or")])
def test_too_much_light_of_a_fit_that_explains_little_may_be_another_light(error, told):
    (*_, last) = doubts(
        error=error,
        classes=[ClassShare(0, 1.0, error)],
        chosen=0,
        albedo=torch.full((4,), 1.5),
        oscillation=1.0,
        clamped=0.0,
        middle=1.0,
        distrust=None,
        spread=None,
    )
    assert last.topic == "too-bright"
    assert told in last.text


def test_few_pixels_are_a_doubt(tiny_library):
    """Of those that show the shape, as the commands say."""
    view = SphereView(12)
    basis = render_basis(tiny_library, LightProbe.default(32), view, samples=64)
    estimator = BRDFEstimator(basis, MaterialClasses.single(tiny_library))
    pixels = len(view.pixels)
    for count in (pixels // 5, pixels // 3):
        mask = ~view.mask
        mask.ravel()[view.pixels[:count]] = True
        result = estimator(basis.image("white"), mask)
        table = result.brdf(tiny_library)
        found = set(doubts_of_result(result, basis, table, mask)) - set(doubts_of_result(result, basis, table))
        few = count < pixels / 4
        assert found == ({f"only {count} of the shape's {pixels} pixels are used"} if few else set())


def test_doubts_are_of_one_photograph_and_its_mask(tiny_library):
    basis = render_basis(tiny_library, LightProbe.default(32), SphereView(12), samples=64)
    results = BRDFEstimator(basis, MaterialClasses.single(tiny_library))(basis.image("white")[None])
    table = results[0].brdf(tiny_library)
    with pytest.raises(ValueError, match=r"^doubts are of a single reconstruction, this holds a batch; pick one: resu"):
        doubts_of_result(results, basis, table)
    with pytest.raises(ValueError, match=r"^mask must be \(1, 12, 12\) like the basis images', got \(12, 12\)$"):
        doubts_of_result(results[0], basis, table, basis.mask[0])


def test_the_clamped_share_counts_measured_zeros_only(tiny_tables):
    table = tiny_tables["white"]
    values = table.values.clone()
    row = table.valid[0, 0].sum()
    values[0, 0, :, 0] = 0
    expected = float(row) / (3 * float(table.valid.sum()))
    assert clamped_share(MerlTable(values, table.valid)) == pytest.approx(expected)


def test_the_middle_of_highlights_is_beside_what_is_brightest_near_them(tiny_tables):
    """White is as bright everywhere; a hole in one plane counts, what lies farther off and single channels do not."""
    white = tiny_tables["white"]
    assert darkest_middle(white) == pytest.approx(1.0)
    values = white.values.clone()
    values[30:] *= 100
    red, green, blue = values[0, 0, 90].tolist()
    values[:2, ..., 1] = 0
    kept = (red + blue) / (red + green + blue)
    assert darkest_middle(MerlTable(values, white.valid)) == pytest.approx(kept)
    values[:4, 45] = 0
    assert darkest_middle(MerlTable(values, white.valid)) == 0


def test_no_material_of_one_lobe_is_dark_in_its_middle(tiny_tables):
    assert all(darkest_middle(table) > DARK_MIDDLE for table in tiny_tables.values())
