"""What the documentation names is there: files, commands and their options; pages stay short."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from paths import ROOT
from torchbrdf.commands import Findings, found as commands_of_torchbrdf

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
SOURCES = [path for folder in ("torchbrdf", "scripts", "tests") for path in sorted((ROOT / folder).rglob("*.py"))]
_PATH = re.compile(r"(?<![\w/.])((?:docs|scripts|tests|torchbrdf)/[\w/]+\.(?:bib|js|md|png|py|safetensors|svg))\b")
_COMMAND = re.compile(r"python (scripts/\S+\.py)((?:\\\n|[^\n`])*)")
SHARED_OPTIONS = {
    "sweep_options": "torchbrdf/experiments/sweep_inputs.py",
    "speed_options": "scripts/benchmarks/speed/checkouts.py",
    "measured_options": "scripts/benchmarks/measured.py",
}

pytestmark = pytest.mark.skipif(not (ROOT / "docs").is_dir(), reason="the documentation is not here")


def test_files_that_are_named_exist():
    written_later = {"docs/X.md"}
    named = {(path, name) for path in [*PAGES, *SOURCES] for name in _PATH.findall(path.read_text())}
    missing = [f"{path.relative_to(ROOT)}: {name}" for path, name in named if not (ROOT / name).exists()]
    assert [one for one in missing if one.split(": ")[1] not in written_later] == []


def commands() -> Iterator[tuple[str, str, list[str]]]:
    """Page, script and options of every command of a script that a page or a docstring shows."""
    for path in [*PAGES, *(ROOT / "scripts").rglob("*.py")]:
        for script, rest in _COMMAND.findall(path.read_text()):
            options = re.findall(r"(?<!\S)--[a-z][a-z-]*", rest.split(" # ")[0])
            yield str(path.relative_to(ROOT)), script, options


def options_of(script: Path) -> set[str]:
    """What a script takes, with what it takes from functions that several share."""
    text = script.read_text()
    for shared, path in SHARED_OPTIONS.items():
        if f"{shared}(" in text:
            text += (ROOT / path).read_text()
    return set(re.findall(r'"(--[a-z][a-z-]*)"', text))


def test_documented_commands_of_scripts_take_their_options():
    found = list(commands())
    assert len(found) > 40
    unknown = []
    for page, script, options in found:
        known = options_of(ROOT / script)
        unknown += [f"{page}: {script} {option}" for option in options if option not in known]
    assert unknown == []


def test_no_page_that_a_person_reads_is_long():
    read = [page for page in PAGES if page.parent.name != "results"]
    assert [page.name for page in read if len(page.read_text().splitlines()) > 250] == []


def test_every_page_of_results_has_its_command_and_is_linked():
    pages = [page for page in PAGES if page.parent.name == "results" and page.name != "index.md"]
    assert pages
    others = "\n".join(page.read_text() for page in PAGES if page.parent.name != "results")
    command = re.compile(r"\b(python (scripts|tests)/|torchbrdf |pytest)")
    assert [page.name for page in pages if not command.search(page.read_text())] == []
    assert [page.name for page in pages if f"results/{page.name}" not in others] == []


def test_the_page_of_the_command_line_tells_of_every_command_and_common_field():
    page = (ROOT / "docs" / "command_line.md").read_text()
    names = [*commands_of_torchbrdf(), *Findings("fit").document(0)]
    assert [name for name in names if f"\n| `{name}` | " not in page] == []


def test_formulas_have_what_their_translation_to_mathml_understands():
    """It takes the next two characters of a fraction without braces for its numerator, and drops bars."""
    odd = re.compile(r"\\t?frac(?!\{)[^$]*|\\bar\b[^$]*")
    assert [f"{page.relative_to(ROOT)}: {part}" for page in PAGES for part in odd.findall(page.read_text())] == []
