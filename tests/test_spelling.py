"""The house spells British: pages, docstrings and comments. Misspellings are what `codespell` is for."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

from paths import ROOT

AMERICAN = re.compile(
    r"\b(?:color(?:s|ed|ful|ing|less)?|behavior\w*|gray(?:s|ish|er)?|centers?|centered|meters?"
    r"|neighbors?|neighboring|neighborhoods?|favors?|favored|favorite|label(?:ed|ing)|model(?:ed|ing)|travel(?:ed|ing)"
    r"|cancel(?:ed|ing)|fulfill|defense|catalogs?|dialogs?|artifacts?|analyz(?:e[ds]?|ing)"
    r"|\w{3,}(?:[lmnrt]iz)(?:e[ds]?|ing|ations?|ers?))\b",
    re.IGNORECASE,
)
KEPT = re.compile(r"`[^`]*`|\"[^\"\n]*\"|'[\w*|-]+'|https?://\S+|\$[^$]*\$|\[[\w ]+\]|\b\w+[._(=]\w*|\b\w+-\w+\b")
"""Code, titles that are quoted, and names with hyphens, such as MERL's materials: as they were given."""

PAGES = [ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "CHANGELOG")]
PAGES += sorted((ROOT / "docs").rglob("*.md"))
SOURCES = [path for folder in ("torchbrdf", "scripts", "tests") for path in sorted((ROOT / folder).rglob("*.py"))]

pytestmark = pytest.mark.skipif(not (ROOT / "docs").is_dir(), reason="the documentation is not here")


def prose_of_page(path: Path) -> Iterator[str]:
    """Paragraphs without code in fences or by indentation."""
    text = re.sub(r"^(`{3,}).*?^\1$", "", path.read_text(), flags=re.MULTILINE | re.DOTALL)
    yield re.sub(r"^    .*$", "", text, flags=re.MULTILINE)


def prose_of_source(path: Path) -> Iterator[str]:
    """Docstrings and comments; none of a file without such a word anywhere, for it takes long to take one apart."""
    text = path.read_text()
    if AMERICAN.search(text) is None:
        return
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield ast.get_docstring(node) or ""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.string


def american(prose: str) -> list[str]:
    return [match[0] for match in AMERICAN.finditer(KEPT.sub(" ", prose))]


@pytest.mark.parametrize("word", "color Colors behavior gray normalized optimize modeling neighbor centered".split())
def test_american_words_are_found(word: str):
    assert american(f"The {word} of `color` and gray-plastic.") == [word]


def test_british_words_and_code_are_not():
    assert american("Colour, `behavior`, normalised, size, prize, `torch.normalize`, \"A Color Model\", modelled") == []


def test_prose_is_british():
    prose = [(page, text) for page in PAGES for text in prose_of_page(page)]
    prose += [(source, text) for source in SOURCES for text in prose_of_source(source)]
    assert [f"{path.relative_to(ROOT)}: {word}" for path, text in prose for word in american(text)] == []
