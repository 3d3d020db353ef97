"""Grades: never good where a warning of substance applies; worse numbers, no better grade."""

import pytest

from torchbrdf.report._improvements import MOST, improvements, sentence
from torchbrdf.report.advice import TOPICS
from torchbrdf.report.grade import FAIR_RESIDUAL, FAIR_SPREAD, GOOD_RESIDUAL, GOOD_SPREAD, HARMLESS, SPOILS, grade_of

ORDER = ["Good", "Fair", "Poor"]


@pytest.mark.parametrize("topic", TOPICS)
def test_a_warning_of_substance_is_never_good(topic):
    word = grade_of(0.001, 0.001, [topic]).word
    assert word == ("Poor" if topic in SPOILS else "Good" if topic in HARMLESS else "Fair")


def test_each_limit_decides():
    assert grade_of(GOOD_RESIDUAL, GOOD_SPREAD, []).word == "Good"
    assert grade_of(1.01 * GOOD_RESIDUAL, GOOD_SPREAD, []).word == "Fair"
    assert grade_of(GOOD_RESIDUAL, 1.01 * GOOD_SPREAD, []).word == "Fair"
    assert grade_of(1.01 * FAIR_RESIDUAL, GOOD_SPREAD, []).word == "Poor"
    assert grade_of(GOOD_RESIDUAL, 1.01 * FAIR_SPREAD, []).word == "Poor"


def test_without_a_posterior_there_is_no_good_grade():
    assert grade_of(0.0, None, []).word == "Not graded"
    assert grade_of(0.5, None, []).word == "Poor"


def test_errors_of_the_capture_come_before_more_light_and_one_action_says_one_thing():
    assert improvements([], []) == []
    assert improvements(["class"], []) == []
    assert improvements(["clamped", "class"], []) == ["clamped"]
    assert improvements(["clamped"], ["gloss", "shadow"]) == ["gloss", "clamped"]
    assert improvements(["clamped", "dark-middle"], ["gloss"]) == ["gloss", "dark-middle"]
    assert improvements(["uncertain"], ["shadow", "grazing"]) == ["shadow"]
    assert improvements(["uncertain"], ["gloss"]) == ["gloss"]
    found = improvements(["uncertain", "unexplained", "normals"], ["gloss"])
    assert found == ["normals", "unexplained"]
    assert len(found) == MOST


def test_what_was_tried_is_not_recommended():
    assert sentence("unexplained", []).startswith("Fit again with `--align`; mask ")
    assert sentence("unexplained", ["--align", "--robust"]) == (
        "Mask reflections of things near by, or check that the probe is of the photograph's room, and `--fov` that of "
        "its camera."
    )
    assert sentence("clamped", []).endswith("fit again with `--constraint lobes`.")
    assert sentence("clamped", ["--constraint lobes"]) == ""
    assert sentence("dark-middle", []) == "For use under lamps and the sun, fit again with `--constraint lobes`."
