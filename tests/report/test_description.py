"""What a result is, in words: the highlight's width in closed form, materials that look like themselves."""

from math import asin, degrees, sqrt
from types import SimpleNamespace

import pytest
import torch

from torchbrdf.brdf.merl import MerlTable
from torchbrdf.light.probe import LightProbe
from torchbrdf.rendering.basis import render_basis
from torchbrdf.report._description import gloss_of, in_words, looks_clipped, most_alike
from torchbrdf.report._figures import theta_h_curve
from torchbrdf.report._first_screen import _gloss
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


def test_a_highlight_that_may_as_well_be_none_is_not_described(tiny_tables):
    table = tiny_tables["red"]
    gloss, top = gloss_of(table), theta_h_curve(table)[0].mean()
    for share, told in ((0.5, str(gloss)), (0.7, "How glossy it is, this photograph does not tell")):
        spread = SimpleNamespace(curve=torch.full((90, 3), share * float(top)))  # 1.645 of them reach zero, or do not
        assert _gloss(SimpleNamespace(spread=spread, found=SimpleNamespace(table=table)), gloss) == told
    assert _gloss(SimpleNamespace(spread=None), gloss) == str(gloss)
