import re
from dataclasses import replace
from html import escape
from math import pi
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pages import Page, pixels
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.estimation.classes import MaterialClasses
from torchbrdf.estimation.estimator import BRDFEstimator
from torchbrdf.images.display import exposure_for, stops_for
from torchbrdf.images.primaries import converted
from torchbrdf.light.probe import LightProbe
from torchbrdf.rendering.basis import render_basis
from torchbrdf.rendering.tables import render
from torchbrdf.report._deviations import Spread, relative_spread, retroreflection_rows
from torchbrdf.report._figures import SURROUND, log_range, on_grey, plane_of_incidence, signed_map, theta_h_curve
from torchbrdf.report._silhouette_section import Scene
from torchbrdf.report.doubts import Doubt
from torchbrdf.report.evidence import (
    Evidence,
    Subject,
    gather,
    leading_materials,
    other_light,
    turn_about_y,
)
from torchbrdf.report.report import write_report
from torchbrdf.view.normal_map import NormalMapView
from torchbrdf.view.sphere import SphereView

SECTIONS = [
    "The photograph and its fit",
    "Under light that was not photographed",
    "What the photograph leaves open",
    "Every class’s candidate",
    "The BRDF",
    "The largest weights",
    "Settings and fingerprints",
]
EVIL = '<b>brass</b> & "co"'


@pytest.fixture(scope="module")
def subjects(tiny_tables):
    """By penalty: of one photograph, averaged over classes or the likeliest."""
    tables = [replace(table, name=EVIL) if name == "gold-0.3" else table for name, table in tiny_tables.items()]
    library = MaterialLibrary.from_tables(tables)
    probe, view = LightProbe.default(32), SphereView(24)
    basis = render_basis(library, probe, view, samples=64)
    classes = MaterialClasses.fit(library, n_classes=2, n_dims=2)
    target = library.combine(0.5 * (torch.eye(30, dtype=torch.float64)[:, 15:18] + torch.eye(30)[:, 21:24].double()))
    photograph = render(target, probe, view, samples=256, seed=5)
    mask = view.mask.clone()
    mask[0, 10:13, 4:8] = False
    results = {penalty: BRDFEstimator(basis, classes, penalty)(photograph, mask) for penalty in ("auto", "paper")}
    return {name: Subject(photograph, mask, found, basis, library, probe, view) for name, found in results.items()}


@pytest.fixture(scope="module", params=["auto", "paper"])
def subject(request, subjects):
    return subjects[request.param]


@pytest.fixture
def likeliest(subjects):
    """For what does not depend on the penalty."""
    return subjects["paper"]


@pytest.fixture(scope="module")
def report(subject, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    settings = {"title": "Ball <1>", "photograph": "ball & <stand>.exr", "penalty": "as it may be"}
    write_report(path, subject, settings, size=32, samples=32)
    return path


def test_a_name_that_is_no_text_is_escaped(likeliest, tmp_path):
    write_report(tmp_path / "r.html", likeliest, {"title": "r\udce9.exr"}, size=16, samples=16)
    assert "r\\udce9.exr" in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_other_primaries_are_told_and_of_the_other_light_too(likeliest, tmp_path):
    for primaries in ("rec709", "aces-ap1"):
        write_report(tmp_path / "r.html", likeliest, {}, primaries=primaries, size=16, samples=16)
        told = "Pictures show linear aces-ap1 as if it were a screen’s RGB" in (tmp_path / "r.html").read_text("utf-8")
        assert told == (primaries == "aces-ap1")
    room, default = other_light(likeliest.probe, "aces-ap1"), LightProbe.default()
    torch.testing.assert_close(converted(room.radiance, "aces-ap1", "rec709"), default.radiance, rtol=1e-4, atol=1e-4)
    assert gather(likeliest, 16, 16, primaries="aces-ap1").probes[1].fingerprint == room.fingerprint


def test_the_page_is_self_contained_and_well_formed(report):
    text = report.read_text(encoding="utf-8")
    page = Page(text)
    assert not re.search(r"https?:|//\w|@import|url\(|<script|<link|<iframe", re.sub(r"base64,[^\"]*", "", text))
    assert page.all("img")
    for attrs in page.all("img"):
        assert attrs["src"].startswith("data:image/png;base64,")
        assert attrs["alt"].strip()
        assert pixels(attrs).shape == (int(attrs["height"]), int(attrs["width"]), 3)
    assert all(set(attrs).isdisjoint({"srcset", "onload"}) for _, attrs in page.tags)
    anchors = {attrs["id"] for _, attrs in page.tags if "id" in attrs}
    links = [attrs["href"] for attrs in page.all("a")]
    assert links
    assert {link.removeprefix("#") for link in links} <= anchors
    assert all(attrs.get("aria-label") or attrs.get("aria-hidden") for attrs in page.all("svg"))


def test_every_section_is_there(report, subject):
    page = Page(report.read_text(encoding="utf-8"))
    text = " ".join(page.text)
    result = subject.result
    averaged = result.posteriors is not None
    sections = [title for title in SECTIONS if averaged or title != "What the photograph leaves open"]
    assert [title for title in SECTIONS if title in text] == sections
    assert f"{float(result.relative_error):.2%}" in text
    assert ("90 % interval" in text, "likeliest" in text, "chosen" in text) == (averaged, averaged, not averaged)
    for probability in result.class_probabilities.tolist() if averaged else []:
        assert f"{probability:.1%}" in text
    errors = (result.class_errors / result.energy).sqrt()
    for error in errors.tolist():
        assert f"{error:.2%}" in text
    assert "A small residual proves nothing." in text
    kinds = [attrs["class"] for attrs in page.all("tr") if attrs.get("class") in ("won", "found", "")]
    assert sorted(kinds, reverse=True) == ["won", *(["found"] if averaged else []), ""]
    kinds = [attrs.get("class") for attrs in page.all("svg")]
    assert kinds.count("polar") == 4
    assert kinds.count("curve") == 1
    assert kinds.count("plan") == 4
    assert sum(attrs.get("class") == "slice" for attrs in page.all("div")) == 2
    for fingerprint in (result.library, subject.basis.probe, subject.basis.view):
        assert fingerprint in text
    assert "12 pixels (grey) are left out: the mask’s, and on the edge those that hold background." in text


def test_names_are_escaped(report):
    text = report.read_text(encoding="utf-8")
    assert "<b>brass" not in text
    assert "&lt;b&gt;brass&lt;/b&gt; &amp;" in text
    assert "ball &amp; &lt;stand&gt;.exr" in text
    assert "<title>Ball &lt;1&gt;</title>" in text


def test_the_photograph_is_shown_upright_at_the_stated_exposure(report, subject):
    page = Page(report.read_text(encoding="utf-8"))
    shown = pixels(next(attrs for attrs in page.all("img") if attrs["alt"] == "the photograph"))
    photograph, mask = subject.photograph, subject.mask
    exposure = exposure_for(photograph, mask)
    expected = (photograph * exposure).clamp(0, 1).movedim(0, -1).numpy() ** (1 / 2.2)
    used = mask[0].numpy()
    assert np.abs(shown - expected)[used].max() < 0.6 / 255
    assert np.allclose(shown[11, 5], SURROUND, atol=0.6 / 255)
    assert f"exposure × {exposure:.3g}" in " ".join(page.text)


def test_the_note_on_the_light_is_how_a_ball_looks_under_it(report, tiny_tables):
    """A lamp in the middle of the picture shines back from the middle of the ball, one at the ends lights no pixel."""
    note = "The middle of the picture of the light lies behind the camera, its left and right ends lie behind the ball."
    assert note in " ".join(Page(report.read_text(encoding="utf-8")).text)
    shown = []
    for columns in ([16, 17], [0, 33]):
        lamp = torch.zeros(3, 17, 34)
        lamp[:, 8, columns] = 1
        shown.append(render(tiny_tables["steel-0.15"], LightProbe(lamp), SphereView(17), samples=256)[0])
    middle, ends = shown
    assert int(middle.argmax()) == 8 * 17 + 8
    assert ends.max() < 1e-4 * middle.max()


def test_the_browser_shows_every_picture_offline(report, browser):
    context = browser.new_context(offline=True, viewport={"width": 1064, "height": 900})
    tab = context.new_page()
    complaints, requests = [], []
    tab.on("console", lambda message: complaints.append(message.text))
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    tab.on("request", lambda request: requests.append(request.url.split(":")[0]))
    tab.goto(report.as_uri())
    widths = tab.evaluate("Array.from(document.images, image => image.complete ? image.naturalWidth : 0)")
    wider = tab.evaluate("document.documentElement.scrollWidth > document.documentElement.clientWidth")
    plates = tab.evaluate(
        "Array.from(document.querySelectorAll('.four'), row => new Set(Array.from(row.children, "
        "figure => Math.round(figure.getBoundingClientRect().top))).size)"
    )
    tab.emulate_media(media="print")
    tab.set_viewport_size({"width": 718, "height": 1000})  # A4 less the default margins
    wider_in_print = tab.evaluate("document.documentElement.scrollWidth > 718")
    assert complaints == []
    assert set(requests) <= {"file", "data"}
    assert len(widths) >= 15
    assert min(widths) > 0
    assert not wider, "the page scrolls sideways"
    assert not wider_in_print, "the page does not fit on A4"
    assert plates == [1, 1, 1], "the four pictures of a row do not stand side by side"


def test_any_known_shape_and_one_class(subject, tmp_path):
    penalty = "paper" if subject.result.posteriors is None else "auto"
    tilted = torch.zeros(3, 6, 9)
    tilted[0], tilted[2] = torch.linspace(-0.5, 0.5, 9), 1.0
    view = NormalMapView(tilted)
    library, probe = subject.library, subject.probe
    basis = render_basis(library, probe, view, samples=32)
    photograph = basis.image("red")
    result = BRDFEstimator(basis, MaterialClasses.single(library), penalty)(photograph)
    path = tmp_path / "r.html"
    write_report(path, Subject(photograph, view.mask, result, basis, library, probe, view), {}, size=16, samples=16)
    text = path.read_text(encoding="utf-8")
    Page(text)
    assert ("The result explains" if penalty == "auto" else "The only class explains") in text
    assert "second best" not in text
    assert "most probable class is" not in text
    assert 'class="large"' in text
    balls = re.findall('class="large disc"[^>]*alt="([^"]*)"', re.sub('base64,[^"]*', "", text))
    assert balls == (["relative standard deviation, under another light"] if penalty == "auto" else [])


def test_the_three_answers_are_on_the_first_screen(report, tmp_path, browser, subject):
    """Also with the longest answers: a photograph that nothing explains; on a phone, the grade and the pictures."""
    noise = 60 * torch.rand(3, 24, 24, generator=torch.Generator().manual_seed(0)) * subject.view.mask
    classes = MaterialClasses.fit(subject.library, n_classes=2, n_dims=2)
    penalty = "paper" if subject.result.posteriors is None else "auto"
    estimator = BRDFEstimator(subject.basis, classes, penalty)
    wrong = replace(subject, photograph=noise, result=estimator(noise, subject.mask))
    observability = estimator.observability(subject.library)
    told = {"observability": observability, "size": 16, "samples": 16}
    verdict = write_report(tmp_path / "r.html", wrong, {"title": "ball.exr"}, **told)
    assert len(verdict.doubts) > 1
    assert str(verdict.grade) == "poor: pictures of it under other light may be off by 15% or more"
    for path in (report, tmp_path / "r.html"):
        tab = browser.new_page(viewport={"width": 1280, "height": 800})
        tab.goto(path.as_uri())
        boxes = [one.bounding_box() for one in tab.locator(".answer, .answers .four").all()]
        assert len(boxes) == 4
        assert max(box["y"] + box["height"] for box in boxes) <= 800
        tab.set_viewport_size({"width": 390, "height": 844})
        boxes = [one.bounding_box() for one in tab.locator(".answer, .answers .four").all()[:2]]
        assert boxes[0]["y"] < boxes[1]["y"]
        assert boxes[1]["y"] + boxes[1]["height"] <= 844
        assert tab.evaluate("document.documentElement.scrollWidth") == 390
        tab.close()
    words = re.findall('class="grade [a-z]+">([^<]*)<', (tmp_path / "r.html").read_text())
    assert words == ["Poor"]
    assert all(f"<p>{escape(str(one))}</p>" in (tmp_path / "r.html").read_text() for one in verdict.doubts)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: {"view": SphereView(24, fov_deg=30.0)}, "the basis images were rendered with another view"),
        (lambda s: {"probe": s.probe.scaled(2)}, "the basis images were rendered with another light probe"),
        (lambda s: {"library": s.library.without("red")}, "this library is not the one that the basis images"),
        (lambda s: {"basis": s.basis.without("red")}, "the basis images are not those of this reconstruction"),
        (lambda s: {"mask": s.mask[0]}, r"mask must be bool \(1, 24, 24\), got torch.bool \(24, 24\)"),
        (lambda s: {"photograph": torch.ones(3, 9, 9)}, r"photograph must be \(3, 24, 24\) like the basis images"),
    ],
)
def test_parts_that_do_not_belong_together(subject, change, message):
    with pytest.raises(ValueError, match=message):
        replace(subject, **change(subject))


def test_a_batch_is_refused(subject):
    batch = BRDFEstimator(subject.basis, MaterialClasses.single(subject.library))(subject.photograph[None])
    message = r"^a report needs a single reconstruction, this holds a batch \(1,\); pick one: result\[i\]$"
    with pytest.raises(ValueError, match=message):
        replace(subject, result=batch)


@pytest.mark.parametrize(
    ("errors", "weights", "clamped", "expected"),
    [
        ((0.01, 0.04), (0.5, 0.5), 0.0, []),
        ((0.06, 0.09), (0.5, 0.5), 0.0, ["The fit leaves 6.0%"]),
        ((0.050, 0.0549), (0.5, 0.5), 0.0, ["Class 1 fits almost as well as class 0 (5.00% against 5.49%)"]),
        ((0.050, 0.0551), (0.5, 0.5), 0.0, []),
        ((0.01,), (16.0, -15.0), 0.0, ["The weights oscillate: their magnitudes add up to 31 times"]),
        ((0.01,), (15.0, -14.0), 0.0, []),
        ((0.01,), (0.5, 0.5), 0.03, ["3.0% of the table"]),
    ],
)
def test_the_warnings(errors, weights, clamped, expected):
    candidates = tuple(
        SimpleNamespace(index=j, error=error, clamped=clamped, probability=None) for j, error in enumerate(errors)
    )
    evidence = Evidence(
        photograph=None, used=None, found=candidates[0], candidates=candidates, chosen=0, names=("a",),
        channel_errors=(), turned=None, directional={}, probes=None, albedo=torch.full((4, 3), 0.5),
        weights=torch.tensor(weights, dtype=torch.float64)[:, None].expand(2, 3),
    )  # fmt: skip
    assert len(evidence.found_doubts) == len(expected)
    for warning, start in zip(map(str, evidence.found_doubts), expected, strict=True):
        assert warning.startswith(start.split(" (")[0])
    dark = set(map(str, replace(evidence, middle=0.2).found_doubts)) - set(map(str, evidence.found_doubts))
    assert [text[:64] for text in dark] == ["Highlights come out 20% as bright in their middle as beside it: "]
    assert evidence.margin == (errors[1] / errors[0] if len(errors) > 1 else float("inf"))


@pytest.mark.parametrize(
    ("probabilities", "typical", "expected"),
    [
        ((0.1, 0.9), 0.1, []),
        ((0.3, 0.45, 0.25), 0.1, ["The photograph does not tell the class: class 1 has a probability of 45%, class 0"]),
        ((0.3, 0.51, 0.19), 0.1, []),
        ((0.1, 0.9), 0.26, ["Under another light the picture is uncertain by 26%"]),
        ((1.0,), 0.1, []),
    ],
)
def test_the_warnings_of_an_average(probabilities, typical, expected):
    """Nearly equal errors of the classes and weights that cancel do not matter: probabilities do."""
    candidates = tuple(
        SimpleNamespace(index=j, error=0.01, clamped=0.0, probability=p) for j, p in enumerate(probabilities)
    )
    evidence = Evidence(
        photograph=None, used=None, found=SimpleNamespace(index=None, error=0.01, clamped=0.0, probability=None),
        candidates=candidates, chosen=int(np.argmax(probabilities)), names=("a",), channel_errors=(), turned=None,
        weights=torch.tensor([[16.0], [-15.0]]).double().expand(2, 3), directional={}, probes=None,
        albedo=torch.full((4, 3), 0.5),
        spread=Spread(torch.zeros(1), torch.zeros(1), torch.zeros(90, 3), torch.zeros(2, 3), typical),
        known=(Doubt("camera", "said before"),),
    )  # fmt: skip
    assert evidence.averaged
    assert [doubt.text for doubt in evidence.doubts] == ["said before", *map(str, evidence.found_doubts)]
    assert len(evidence.found_doubts) == len(expected)
    for warning, start in zip(map(str, evidence.found_doubts), expected, strict=True):
        assert warning.startswith(start)


def test_the_result_is_shown_and_not_the_best_candidate(subject):
    evidence = gather(subject, 16, 16)
    result, library = subject.result, subject.library
    assert evidence.found.table is (subject.tables[0] if evidence.averaged else subject.tables[1 + evidence.chosen])
    assert torch.allclose(evidence.found.table.values, result.brdf(library).values, rtol=1e-5, atol=1e-6)
    assert torch.allclose(evidence.weights, result.weights.double())
    assert evidence.found.error == pytest.approx(float(result.relative_error), rel=1e-4)
    assert torch.allclose(evidence.found.fitted, result.image, rtol=1e-3, atol=1e-4)
    assert evidence.averaged == (result.posteriors is not None)
    if not evidence.averaged:
        assert evidence.found is evidence.candidates[evidence.chosen]
        assert evidence.spread is None
        return
    assert not torch.equal(evidence.found.table.values, evidence.best.table.values)
    assert [candidate.probability for candidate in evidence.candidates] == result.class_probabilities.tolist()
    curve = result.brdf_std(library)[:, 0]
    assert evidence.spread.curve.shape == (90, 3)
    assert (evidence.spread.curve > 0).all()
    assert (evidence.spread.curve.mean(0) < 1.5 * curve.mean((0, 1))).all()  # a mean over phi_d varies less than a cell


def test_the_other_light_is_another(likeliest):
    """Also for a photograph under the default probe, as in the demo."""
    default = LightProbe.default()
    assert other_light(likeliest.probe).fingerprint == default.fingerprint
    turned = other_light(default)
    assert turned.fingerprint != default.fingerprint
    assert torch.allclose(turned.total_power, default.total_power, rtol=0.01)


def test_the_room_that_was_photographed_is_no_new_one(likeliest):
    evidence = gather(likeliest, 12, 16)
    assert evidence.other_room == "torchbrdf’s studio room"
    basis = replace(likeliest.basis, probe=LightProbe.default().fingerprint)
    taken_there = gather(replace(likeliest, probe=LightProbe.default(), basis=basis), 12, 16)
    assert taken_there.other_room == "the same room, turned by 180°"


def test_the_spread_is_relative_and_0_in_the_dark():
    deviation, radiance = torch.tensor([[3.0], [0.0], [4.0]]), torch.tensor([[0.0], [10.0], [0.0]])
    assert float(relative_spread(deviation, radiance)) == pytest.approx(0.5)
    assert float(relative_spread(deviation, 0 * radiance)) == 0


def test_the_rows_of_the_curve(tiny_library, tiny_tables):
    """One material's own weights: its curve."""
    rows = retroreflection_rows(tiny_library)
    for name in ("white", "gold-0.3"):
        i = 3 * tiny_library.names.index(name)
        assert np.allclose(rows[:, i : i + 3].numpy(), theta_h_curve(tiny_library.table(name)), rtol=1e-5)


def test_a_shape_with_few_normals_is_the_first_warning():
    candidate = SimpleNamespace(index=0, error=0.9, clamped=0.0, probability=None)
    evidence = Evidence(
        photograph=None, used=None, found=candidate, candidates=(candidate,), chosen=0, names=("a",),
        channel_errors=(), turned=None, directional={}, probes=None, albedo=torch.full((4, 3), 0.5),
        distrust="the shape is a plane", weights=torch.ones(2, 3, dtype=torch.float64),
    )  # fmt: skip
    assert str(evidence.found_doubts[0]) == "The shape is a plane."
    assert len(evidence.found_doubts) == 2


def test_more_light_than_there_was_is_a_warning():
    candidate = SimpleNamespace(index=0, error=0.01, clamped=0.0, probability=None)
    evidence = Evidence(
        photograph=None, used=None, found=candidate, candidates=(candidate,), chosen=0, names=("a",),
        channel_errors=(), turned=None, directional={}, probes=None,
        albedo=torch.tensor([0.9, 1.6, 1.2, 1.0])[:, None].expand(4, 3),
        weights=torch.ones(2, 3, dtype=torch.float64),
    )  # fmt: skip
    assert len(evidence.found_doubts) == 1
    assert str(evidence.found_doubts[0]).startswith("The result reflects 1.60 times the light that comes in at 30°")


def test_the_turn_takes_the_camera_side_to_image_right():
    turned = turn_about_y(90.0) @ torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    assert torch.allclose(turned, torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64), atol=1e-12)


def test_leading_materials_rank_by_any_channel():
    weights = torch.zeros(9, 3)
    weights[4, 2], weights[8, 0] = -0.5, 0.3
    assert leading_materials(weights, ["a", "b", "c"], 3) == ("b", "c")


def test_exposures():
    ramp = torch.linspace(0, 8, 101).expand(3, 1, 101)
    assert exposure_for(ramp, torch.ones(1, 1, 101, dtype=torch.bool)) == pytest.approx(1 / 7.92)
    assert exposure_for(0 * ramp, torch.ones(1, 1, 101, dtype=torch.bool)) == 1.0
    assert stops_for(ramp) == (0.125, 0.125)
    highlight = torch.full((3, 10, 10), 0.125)
    highlight[:, 0, 0] = 64.0
    assert stops_for(highlight)[1] == 4.0
    assert stops_for(highlight)[0] < 1 / 16
    assert stops_for(0 * ramp) == (1.0, 1.0)


def test_the_surround_is_neutral_and_the_rim_continues_the_shape():
    view = SphereView(16)
    image = torch.where(view.mask, torch.tensor([0.2, 0.4, 0.6])[:, None, None], torch.zeros(3, 16, 16))
    shown = on_grey(image, 2.0, view.mask, view.mask)
    assert torch.allclose(shown[:, 0, 0], torch.full((3,), SURROUND**2.2 / 2))
    edge = int(torch.nonzero(view.mask[0, 4]).min()) - 1
    assert torch.allclose(shown[:, 4, edge], torch.tensor([0.2, 0.4, 0.6]), atol=1e-5)
    hole = view.mask.clone()
    hole[0, 8, 8] = False
    assert torch.allclose(on_grey(image, 2.0, hole, view.mask)[:, 8, 8], torch.full((3,), SURROUND**2.2 / 2))


def test_the_signed_map_is_blue_below_and_red_above():
    everywhere = torch.ones(1, 1, 5, dtype=torch.bool)
    colours = signed_map(torch.tensor([[[-9.0, -0.05, 0.0, 0.05, 9.0]]]), 0.1, everywhere)[:, 0]
    assert (colours[2, :2] > colours[0, :2]).all()
    assert (colours[0, 3:] > colours[2, 3:]).all()
    assert colours[:, 2].min() > 0.9
    unused = signed_map(torch.zeros(1, 1, 5), 0.1, ~everywhere)
    assert torch.allclose(unused, torch.tensor(SURROUND**2.2))


def test_the_curves_of_a_known_brdf(tiny_tables):
    matte = tiny_tables["white"]
    theta_o, f_r = plane_of_incidence(matte, 30.0)
    assert (np.diff(theta_o) > 0).all()
    assert np.allclose(f_r, np.array([0.8, 0.8, 0.75]) / pi, rtol=1e-5)
    assert np.allclose(theta_h_curve(matte), np.array([0.8, 0.8, 0.75]) / pi, rtol=1e-5)
    theta_o, f_r = plane_of_incidence(tiny_tables["copper-0.08"], 30.0)
    assert theta_o[f_r[:, 0].argmax()] == pytest.approx(30, abs=1.5)


def test_the_decades_of_a_log_axis():
    assert log_range(np.array([0.02] * 99 + [5.0])) == (-3, 1)
    assert log_range(np.array([0.0, 0.0])) == (-1, 0)
    low, high = log_range(np.array([1e-12] * 99 + [1e3]))
    assert high - low == 7
    assert high == 4


def test_the_silhouette_is_drawn_on_the_whole_photograph(likeliest, tmp_path):
    turn = torch.arange(64) * (2 * pi / 64)
    outline = torch.stack([150 + 30.5 * turn.cos(), 60 - 30.5 * turn.sin()], -1)
    scene = Scene(torch.ones(3, 90, 200), outline, "as given")
    write_report(tmp_path / "a.html", likeliest, {}, scene=scene, size=16, samples=16)
    page = (tmp_path / "a.html").read_text()
    whole, enlarged = re.findall(r'viewBox="0 0 (\d+) (\d+)" aria-hidden="true"><polygon points="([\d., -]*)"', page)
    assert whole[:2] == ("200", "90")
    assert whole[2].startswith("180.50,60.00 ")
    assert enlarged[:2] == ("80", "70")
    assert enlarged[2].startswith("70.50,40.00 ")


def test_the_whole_photograph_has_the_exposure_of_the_ball(likeliest, tmp_path):
    """A lamp elsewhere in it, which its own exposure would show, leaves both pictures as they were."""
    outline = torch.tensor([[120.0, 60.0], [150.0, 30.0], [180.0, 60.0], [150.0, 90.0]])
    photograph = torch.full((3, 90, 200), 0.25)
    photograph[:, :40, :40] = 1000.0
    write_report(
        tmp_path / "a.html", likeliest, {}, scene=Scene(photograph, outline, "as given"), size=16, samples=16
    )
    page = Page((tmp_path / "a.html").read_text(encoding="utf-8"))
    images = {attrs["alt"]: pixels(attrs) for attrs in page.all("img")}
    assert images["The ball"].min() == images["The whole photograph"][50:, 50:].min() == 1
    text = " ".join(page.text)
    assert "As given." in text
    assert "both shown with exposure × 4, at which" in text
