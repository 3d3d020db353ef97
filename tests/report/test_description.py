"""What a result is, in words: the highlight's width in closed form, materials that look like themselves."""

import re
from math import asin, degrees, exp, pi, sqrt
from types import SimpleNamespace

import pytest
import torch

from torchbrdf.brdf import cell_centres
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.light.probe import LightProbe
from torchbrdf.rendering.basis import render_basis
from torchbrdf.report._description import gloss_of, held_by_library, in_words, looks_clipped, most_alike
from torchbrdf.report._deviations import highlight_row
from torchbrdf.report._figures import theta_h_curve
from torchbrdf.report._first_screen import _gloss, _good
from torchbrdf.report.doubts import Doubt
from torchbrdf.report.grade import GRADES
from torchbrdf.view.sphere import SphereView


def test_a_matt_surface_has_no_highlight_and_its_albedo(tiny_tables):
    gloss = gloss_of(tiny_tables["red"])
    assert gloss.contrast == pytest.approx(1)
    assert gloss.beside == pytest.approx((0.6, 0.1, 0.05), rel=1e-4)
    assert str(gloss).startswith("Matt")


@pytest.mark.parametrize("alpha", [0.05, 0.15, 0.3])
def test_the_half_width_of_a_lobe(alpha):
    """alpha^2 / (1 + (alpha^2 - 1) cos^2)^2 is half its peak where alpha^2 + sin^2 (1 - alpha^2) = sqrt(2) alpha^2."""

    def lobe(w_i, w_o):
        cosine = torch.nn.functional.normalize(w_i + w_o, dim=-1)[..., 2:]
        return (alpha**2 / (cosine**2 * (alpha**2 - 1) + 1) ** 2).expand(*w_i.shape[:-1], 3)

    sine = alpha * sqrt((sqrt(2) - 1) / (1 - alpha**2))
    width = degrees(asin(sine))
    assert gloss_of(MerlTable.from_function(lobe, "lobe")).width == pytest.approx(width, rel=0.03)


def test_a_material_of_the_library_looks_most_like_itself(tiny_library):
    probe, view = LightProbe.default(32), SphereView(12)
    basis = render_basis(tiny_library, probe, view, samples=64)
    alike = most_alike(basis.image("gold-0.3"), view.mask, 1.0, basis, 2)
    assert alike[0].name == "gold-0.3"
    assert alike[0].difference == pytest.approx(0, abs=1e-6)
    assert alike[1].difference > 0.01
    assert torch.equal(alike[0].image, basis.image("gold-0.3"))


def test_what_the_library_holds_is_told_from_what_is_near(tiny_library):
    """Used pixels count alone, and noise of the renderer is no difference; half as bright is another material."""
    view = SphereView(12)
    basis = render_basis(tiny_library, LightProbe.default(32), view, samples=64)
    own, used = basis.image("gold-0.3"), view.mask.clone()
    used[0, 3] = False
    seen = torch.where(used, own * 1.01, 0)
    assert held_by_library(seen, used, basis) == "gold-0.3"
    assert held_by_library(seen, view.mask, basis) is None
    assert held_by_library(own / 2, view.mask, basis) is None


def test_lists_in_words():
    assert [in_words(names) for names in ([], ["a"], ["a", "b"], ["a", "b", "c"])] == ["", "a", "a and b", "a, b and c"]


def test_a_plateau_below_the_fit_is_clipped():
    ramp = torch.linspace(0, 1, 36).reshape(6, 6).expand(3, 6, 6)
    used = torch.ones(1, 6, 6, dtype=torch.bool)
    assert looks_clipped(ramp.clamp_max(0.8), ramp, used)
    assert not looks_clipped(ramp, ramp, used)
    assert not looks_clipped(ramp.clamp_max(0.8), ramp, used & (ramp[:1] < 0.8))
    assert not looks_clipped(torch.full_like(ramp, 0.5), torch.full_like(ramp, 0.5), used)
    assert not looks_clipped(0 * ramp, ramp, used)


NOT_TOLD = "How glossy it is, this photograph does not tell"


def said_of(table, highlight, of_highlight, of_top=0.0):
    """The sentence where the highlight is so much brighter, to a share of that, and its top is known to a share.

    of_top  share of its brightest cell, of all cells, or of the first cells one by one, the others being known
    """
    curve = theta_h_curve(table)
    shares = torch.zeros(90)
    shares[: len(of_top) if isinstance(of_top, list) else 90] = torch.tensor(of_top)
    spread = SimpleNamespace(
        highlight=torch.tensor([[highlight], [of_highlight * highlight]]).expand(2, 3),
        curve=(shares * float(curve.mean(1).max()))[:, None].expand(90, 3),
    )
    return _gloss(SimpleNamespace(spread=spread, found=SimpleNamespace(table=table)), gloss_of(table))


def test_a_highlight_that_may_as_well_be_none_is_not_described(tiny_tables):
    gold = tiny_tables["gold-0.3"]
    assert not gloss_of(gold).matt
    assert said_of(gold, 1.0, 0.5) == str(gloss_of(gold))  # 1.645 of them do not reach zero
    assert said_of(gold, 1.0, 0.7) == NOT_TOLD
    assert _gloss(SimpleNamespace(spread=None), gloss_of(gold)) == str(gloss_of(gold))


def test_a_highlight_whose_top_alone_is_not_told_is_described_without_it(tiny_tables):
    """A spike that the photograph does not tell makes no soft highlight a sharp one."""
    gold = tiny_tables["gold-0.3"]
    values = gold.values.clone()
    values[:3] *= torch.tensor([50.0, 9.0, 0.0])[:, None, None, None]
    spiked = MerlTable(values, gold.valid)
    assert "sharp" in str(gloss_of(spiked))
    of_top = "; how bright in its very middle, this photograph does not tell"
    said = said_of(spiked, 1.0, 0.1, [1.0, 1.0, 1.0, 0.0])
    assert said == f"{gloss_of(gold, 3)}{of_top}"
    assert gloss_of(gold, 3).width == pytest.approx(gloss_of(gold).width, rel=0.05)


def test_a_hole_in_the_middle_that_the_photograph_does_not_tell_makes_no_highlight_none(tiny_tables):
    gold = tiny_tables["gold-0.3"]
    values = gold.values.clone()
    values[:4] = 0
    holed = MerlTable(values, gold.valid)
    assert gloss_of(holed).matt
    of_top = "; how bright in its very middle, this photograph does not tell"
    assert said_of(holed, 1.0, 0.1, [1.0, 1.0, 1.0, 1.0]) == f"{gloss_of(gold, 4)}{of_top}"


def test_a_highlight_of_which_only_its_mean_is_told(tiny_tables):
    gold = tiny_tables["gold-0.3"]
    assert said_of(gold, 1.0, 0.1, 0.7) == "Glossy; how sharp its highlight is, this photograph does not tell"
    assert said_of(gold, 1.0, 0.1, 0.5) == str(gloss_of(gold))


def test_a_surface_is_matt_where_a_highlight_as_bright_as_it_is_ruled_out(tiny_tables):
    red = tiny_tables["red"]
    beside = sum(gloss_of(red).beside) / (3 * pi)
    assert said_of(red, beside, 0.5) == str(gloss_of(red))
    assert said_of(red, beside, 0.7) == NOT_TOLD


@pytest.mark.parametrize("width", [3.0, 40.0])
def test_a_highlight_is_the_mean_over_its_solid_angle(width):
    """Of exp(-theta_h^2 / 2 s^2) over 0.2, up to a: s^2 (1 - exp(-a^2 / 2 s^2)) 2 / a^2, less what lies beside.

    a  the end of the cell that holds 6 degrees
    """
    theta_h = cell_centres()[0].ravel().rad2deg().double()
    lobe = torch.exp(-(theta_h.square()) / (2 * width**2))
    end = 23**2 / 90  # cells end at i^2 / 90 degrees
    inside = (1 - exp(-(end**2) / (2 * width**2))) * 2 * width**2 / end**2
    beside = float(lobe[(theta_h > 45) & (theta_h < 75)].mean())
    assert float(highlight_row(0.2 + lobe[:, None])) == pytest.approx(inside - beside, rel=0.03)


@pytest.mark.parametrize(
    ("topics", "said"),
    [
        ((), ["no warning", "photograph and probe taken as in one unit"]),
        (
            ("clamped",),
            ["no warning", "Noted: Negative values were cut off", "photograph and probe taken as in one unit"],
        ),
        (("reflectance",), ["Warned of: The reflectance of the mirror ball is not known"]),
        (("no-unit", "class"), ["Warned of: The photograph has no unit", "Noted: The class is not told"]),
    ],
)
def test_what_a_good_result_may_have_is_noted_and_not_warned_of(topics, said):
    """As on the terminal."""
    evidence = SimpleNamespace(
        found=SimpleNamespace(error=0.01),
        typical_spread=None,
        grade=GRADES["Good"],
        doubts=[Doubt(topic, "") for topic in topics],
    )
    (numbers,) = re.findall('class="note">(.*?)</p>', _good(evidence))
    assert re.sub("<[^>]*>", "", numbers).split(" · ") == ["1.0% of the photograph unexplained", *said, "Limits"]
