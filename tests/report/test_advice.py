"""What warnings mean: the same words in the report and in the documentation, and commands that exist."""

import re
from types import SimpleNamespace

import pytest

import write_warnings
from paths import ROOT
from torchbrdf.cli import parser
from torchbrdf.report._warnings_section import warnings_section
from torchbrdf.report.advice import ADVICE, TOPICS, Topic, marked
from torchbrdf.report.doubts import Doubt


def test_the_page_says_what_the_report_says():
    assert write_warnings.main(["--check"]) == 0


def test_every_topic_has_a_paragraph_of_its_own():
    assert set(ADVICE) == set(TOPICS)
    anchors = [advice.anchor for advice in ADVICE.values()]
    assert len(set(anchors)) == len(anchors)
    assert all(re.fullmatch("[a-z-]+", anchor) for anchor in anchors)


@pytest.mark.parametrize("topic", TOPICS)
def test_pages_and_options_exist(topic):
    advice = ADVICE[topic]
    page, _, anchor = advice.page.partition("#")
    headings = re.findall("^#+ (.*)$", (ROOT / "docs" / page).read_text(), re.M)
    slugs = [re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings]
    assert not anchor or anchor in slugs


def test_options_and_commands_exist():
    (commands,) = (one.choices for one in parser()._actions if isinstance(one.choices, dict))
    for advice in ADVICE.values():
        for code in re.findall("`([^`]*)`", f"{advice.actions} {advice.meaning} {advice.remedy}"):
            words = code.removeprefix("torchbrdf ").split()
            command = words[0] if code.startswith("torchbrdf ") else "fit"
            options = {word for word in words if word.startswith("--")}
            assert options <= set(commands[command]._option_string_actions), code


def test_code_is_marked_and_the_rest_is_escaped():
    assert marked("a < `b > c` & d") == "a &lt; <code>b &gt; c</code> &amp; d"
    assert marked("`fit --same-material`") == "<code>fit <span>--same-material</span></code>"


@pytest.mark.parametrize(
    ("topics", "acts", "title"),
    [
        (["class", "clipped"], [], "What the warnings mean"),
        (["class", "clamped"], ["clamped"], "What the notes mean"),
        ([], ["shadow"], "What would help, and why"),
    ],
)
def test_the_section_is_of_warnings_or_of_notes(topics: list[Topic], acts: list[Topic], title: str):
    evidence = SimpleNamespace(doubts=[Doubt(topic, "Said.") for topic in topics])
    (section,) = warnings_section(evidence, acts)
    assert f">{title}<" in section
