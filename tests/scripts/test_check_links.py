"""The link checker finds what leads nowhere, and nothing else."""

from pathlib import Path

import pytest

from paths import ROOT

pytest.importorskip("markdown_it")
import check_links as script

pytestmark = pytest.mark.skipif(not (ROOT / "docs").is_dir(), reason="the documentation is not here")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "docs").mkdir()
    for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"):
        (tmp_path / name).write_text("# Title\n")
    (tmp_path / "picture.png").write_bytes(b"")
    (tmp_path / "docs" / "page.md").write_text(
        "# A page\n\n## What's `this`, and $x$?\n\n## Twice\n\n## Twice\n\n(a-target)=\n\n"
        "```{eval-rst}\n.. autofunction:: torchbrdf.render\n```\n"
    )
    return tmp_path


def faults(root: Path, text: str) -> list[str]:
    (root / "README.md").write_text(text)
    return script.check(root)[0]


@pytest.mark.parametrize(
    "link",
    [
        "[a](./docs/page.md)",
        "[a](./docs/page.md#whats-this-and-x)",
        "[a](./docs/page.md#twice-1)",
        "[a](./docs/page.md#a-target)",
        "[a](./docs/page.md#torchbrdf.render)",
        "[a](#here)\n\n# Here",
        "![a](picture.png)",
        '<p align="center"><img src="picture.png"></p>',
        "`[a](nowhere.md)`",
        "    [a](nowhere.md)",
        "[a](https://example.org/page#part)",
        "[a][b]\n\n[b]: ./docs/page.md",
    ],
)
def test_what_leads_somewhere_is_no_fault(root: Path, link: str):
    assert faults(root, link) == []


@pytest.mark.parametrize(
    ("link", "said"),
    [
        ("\n[a](./docs/none.md)", "README.md:2: ./docs/none.md: there is no"),
        ("[a](./docs/page.md#twice-2)", "page.md has no heading of that name"),
        ("[a](./docs/page.md#What-s-this)", "page.md has no heading of that name"),
        ("[a](#nowhere)", "README.md has no heading of that name"),
        ("![a](none.png)", "there is no none.png"),
        ('<img src="none.png">', "there is no none.png"),
        ("<b>x</b> <a href='none.md'>a</a>", "there is no none.md"),
        ("```{image} none.png\n```", "there is no none.png"),
        ("```{toctree}\n:maxdepth: 1\n\ndocs/page\nnone\n```", "there is no none.md"),
        ("[a](../outside.md)", "leads out of the repository"),
        ("[a](/page.md)", "must be relative to the page"),
        ("[a](http://example.org)", "must be a whole https address"),
        ("[a](https://example)", "must be a whole https address"),
        ('<a href="https://[x">', "is no address"),
        ("[a][b]\n\n[b]: none.md", "there is no none.md"),
    ],
)
def test_what_leads_nowhere_is_told(root: Path, link: str, said: str):
    (found,) = faults(root, link)
    assert said in found


def test_addresses_elsewhere_are_listed_once(root: Path):
    (root / "docs" / "references.bib").write_text("@manual{A,\n  url = {https://example.org/b}\n}\n")
    (root / "README.md").write_text("[a](https://example.org/a), [b](https://example.org/a)")
    assert script.check(root) == ([], ["https://example.org/a", "https://example.org/b"])


def test_every_page_of_the_repository_leads_somewhere():
    told, _ = script.check(ROOT)
    assert told == []
