"""The reference: every public name is on a page, with shapes and an example; glossary and citation are of this code."""

import inspect
import re
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import torchbrdf
from paths import ROOT

API = ROOT / "docs" / "api"
PAGES = sorted(path for path in API.glob("*.md") if path.name != "index.md")
_ENTRY = re.compile(r"^\.\. auto(?:class|function|data|module):: (\S+)$", re.MULTILINE)
_ROW = re.compile(r"\[`[\w.]+`\]\(#([\w.]+)\)")
_AXIS = r"(?:\.\.\.|\*batch|\d+|\w+(?:[ ^]\w+){0,2})"
_SHAPE = re.compile(rf"\({_AXIS}(?:, ?{_AXIS})+,?\)|\({_AXIS},\)|\(\.\.\.\)|\(\*batch\)")
_MEMBERS = re.compile(r"^\.\. autoclass:: (\S+)\n   :members:(.*)$", re.MULTILINE)

pytestmark = pytest.mark.skipif(not API.is_dir(), reason="the documentation is not here")


def entries(page: Path) -> list[str]:
    return _ENTRY.findall(page.read_text())


def members(page: Path) -> list[tuple[str, str]]:
    """Classes of a page whose methods it shows, and which; none named means all."""
    return _MEMBERS.findall(page.read_text())


def documented(name: str) -> Any:
    """The object of a dotted name: a module, or something in one."""
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found = import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for part in parts[cut:]:
            found = getattr(found, part)
        return found
    raise LookupError(name)


def described() -> list[tuple[str, Any, str]]:
    """Name, callable and docstring of what the pages document: functions, classes, and the methods shown of these."""
    found = []
    for page in PAGES:
        shown = {name: [one for one in names.replace(" ", "").split(",") if one] for name, names in members(page)}
        for name in entries(page):
            thing = documented(name)
            if inspect.isclass(thing):
                methods = {key: getattr(member, "__func__", member) for key, member in vars(thing).items()}
                for key in shown.get(name, ()) or (methods if name in shown else ()):
                    if inspect.isfunction(methods.get(key)) and not key.startswith("_"):
                        found.append((f"{name}.{key}", methods[key], inspect.getdoc(methods[key]) or ""))
                found.append((name, thing.__init__, inspect.getdoc(thing) or ""))
            elif callable(thing):
                found.append((name, thing, inspect.getdoc(thing) or ""))
    return found


def test_every_public_name_is_on_one_page():
    listed = [name for page in PAGES for name in entries(page)]
    assert sorted(f"torchbrdf.{name}" for name in torchbrdf.__all__) == sorted(
        name for name in listed if name.count(".") == 1
    )
    assert len(listed) == len(set(listed))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_begins_with_an_example_and_lists_its_names(page: Path):
    text = page.read_text()
    assert 0 < text.find("```python\n>>> ") < text.find("| name |") < text.find("```{eval-rst}")
    assert sorted(_ROW.findall(text)) == sorted(entries(page))


def test_pages_are_on_the_first_one():
    text = (API / "index.md").read_text()
    assert sorted(re.findall(r"\]\((\w+)\.md\)", text)) == [page.stem for page in PAGES]


def test_what_is_documented_says_what_it_is_and_the_shapes_of_its_tensors():
    found = described()
    assert len(found) > 150
    assert [name for name, _, text in found if len(text.split()) < 2] == []
    without = []
    for name, function, text in found:
        taken = [str(one.annotation) for one in inspect.signature(function).parameters.values()]
        if any(re.search(r"\bTensor\b", annotation) for annotation in taken) and not _SHAPE.search(text):
            without.append(name)
    assert without == []


def test_the_glossary_names_what_is_in_the_code():
    text = (ROOT / "docs" / "glossary.md").read_text()
    sources = "\n".join(path.read_text() for path in (ROOT / "torchbrdf").rglob("*.py"))
    rows = [line for line in text.splitlines() if line.startswith("| $")]
    assert len(rows) > 40
    cells = [re.split(r" *(?<!\\)\| *", row)[4] for row in rows]
    names = {name for cell in cells for name in re.findall(r"`([A-Za-z_.]+)`", cell)} - {"image"}
    paths = {name for cell in cells for name in re.findall(r"`([a-z_]+/[a-z_/.]*)`", cell)}
    last = {name.rpartition(".")[2] for name in names}
    assert [name for name in sorted(last) if not re.search(rf"\b{name}\b", sources)] == []
    assert [path for path in sorted(paths) if not (ROOT / "torchbrdf" / path).exists()] == []


def test_the_citation_is_of_this_version():
    yaml = pytest.importorskip("yaml")
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["cff-version"] == "1.2.0"
    assert citation["version"] == torchbrdf.__version__
    assert (citation["title"], citation["license"], citation["type"]) == ("torchbrdf", "MIT", "software")
    assert citation["message"]
    for work in (citation, *citation["references"]):
        assert all("name" in author or {"family-names", "given-names"} <= author.keys() for author in work["authors"])


def test_what_is_cited_is_as_in_the_bibliography():
    yaml = pytest.importorskip("yaml")
    references = yaml.safe_load((ROOT / "CITATION.cff").read_text())["references"]
    bibliography = (ROOT / "docs" / "references.bib").read_text()
    plain = re.sub(r"[{}]", "", bibliography)
    assert len(references) == 4
    for work in references:
        assert work["type"] == "article"
        assert f"title   = {work['title']}," in plain
        assert work["authors"][0]["family-names"] in plain
        assert work.get("doi", "1906.04777") in plain
    page = (ROOT / "docs" / "citing.md").read_text()
    (entry,) = re.findall(r"@article\{CBP21,.*?\n\}", bibliography, re.DOTALL)
    assert entry in page
    assert [key for key in ("MPBM03", "SRRW21", "DJ18", "Deb98") if key not in page] == []
