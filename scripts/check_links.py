"""What the pages link to is there: files, headings and pictures of the repository, without the network.

    python scripts/check_links.py

Looks at the README, CONTRIBUTING, CHANGELOG and every page of docs/. A relative link must lead to a file of the
repository, and what stands after its # to a heading, a target or an object of the API on that page. Addresses elsewhere
must be https and are listed, for a person to try; none is opened. One line for each fault, and exit status 1.
"""

import argparse
import re
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote, urlsplit

from markdown_it import MarkdownIt
from markdown_it.token import Token

PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs")
_TARGET = re.compile(r"^\(([\w-]+)\)=$", re.MULTILINE)
_OBJECT = re.compile(r"^\.\. auto\w+:: (\S+)$", re.MULTILINE)
_FIGURE = re.compile(r"^```\{(?:image|figure|literalinclude)\} (\S+)$", re.MULTILINE)
_TREE = re.compile(r"^```\{toctree\}\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_HTML = re.compile(r"""\b(?:href|src|srcset)=["']([^"'\s]+)""")
_BIBLIOGRAPHY = re.compile(r"^\s*url\s*=\s*\{(.*)\}", re.MULTILINE)
_MARKDOWN = MarkdownIt("commonmark").enable("table")


@dataclass(frozen=True)
class Link:
    """Where a page leads, and from which of its lines."""

    page: Path
    line: int
    address: str


def pages_of(root: Path) -> list[Path]:
    """The pages that are checked and the bibliography, without what Sphinx built."""
    given = [root / name for name in PAGES]
    found = [path for one in given for path in (sorted(one.rglob("*")) if one.is_dir() else [one])]
    return [path for path in found if path.suffix in (".md", ".bib") and "_build" not in path.parts]


def _inline(tokens: list[Token]) -> Iterator[tuple[int, Token]]:
    for token in tokens:
        line = (token.map or [0])[0] + 1
        yield from ((line, child) for child in [token, *(token.children or [])])


def _lines(text: str, pattern: re.Pattern[str]) -> Iterator[tuple[int, str]]:
    for match in pattern.finditer(text):
        yield text.count("\n", 0, match.start()) + 1, match[1]


def links_of(page: Path) -> list[Link]:
    """All links and pictures of a page, those of HTML and of MyST's directives too."""
    text = page.read_text()
    if page.suffix == ".bib":
        return [Link(page, line, address) for line, address in _lines(text, _BIBLIOGRAPHY)]
    found = list(_lines(text, _FIGURE))
    for line, token in _inline(_MARKDOWN.parse(text)):
        if token.type.startswith("html"):
            found += [(line, address) for address in _HTML.findall(token.content)]
        elif token.type in ("link_open", "image"):
            found.append((line, str(token.attrGet("href" if token.type == "link_open" else "src"))))
    for line, tree in _lines(text, _TREE):
        entries = [entry.strip() for entry in tree.splitlines()]
        found += [(line, f"{entry}.md") for entry in entries if entry and not entry.startswith(":")]
    return [Link(page, line, address) for line, address in found]


def anchor(title: str) -> str:
    """What a heading is called after the #, on GitHub and by MyST: lower case, hyphens, letters and digits only."""
    return re.sub(r"[^\w\- ]", "", title.strip().lower()).replace(" ", "-")


def anchors_of(page: Path) -> set[str]:
    """What may stand after the # of a link to a page: headings, counted where they repeat, targets, API objects."""
    text = page.read_text()
    tokens = _MARKDOWN.parse(text)
    titles = [after.children or [] for token, after in pairwise(tokens) if token.type == "heading_open"]
    headings: Counter[str] = Counter()
    found = set(_TARGET.findall(text)) | set(_OBJECT.findall(text))
    for parts in titles:
        name = anchor("".join(part.content for part in parts if part.type in ("text", "code_inline", "math_inline")))
        found.add(f"{name}-{headings[name]}" if headings[name] else name)
        headings[name] += 1
    return found


def fault(link: Link, root: Path) -> str | None:
    """What is wrong with a link; None where it leads somewhere."""
    try:
        parts = urlsplit(link.address)
        host = parts.hostname
    except ValueError as error:
        return f"is no address ({error})"
    if parts.scheme or parts.netloc:
        return None if parts.scheme == "https" and host and "." in host else "must be a whole https address"
    if link.address.startswith("/"):
        return "must be relative to the page"
    target = (link.page.parent / unquote(parts.path)).resolve() if parts.path else link.page.resolve()
    if not target.is_relative_to(root.resolve()):
        return "leads out of the repository"
    if not target.exists():
        return f"there is no {target.relative_to(root.resolve())}"
    if parts.fragment and (target.suffix != ".md" or unquote(parts.fragment) not in anchors_of(target)):
        return f"{target.relative_to(root.resolve())} has no heading of that name"
    return None


def check(root: Path) -> tuple[list[str], list[str]]:
    """Faults, a line each, and the addresses elsewhere of all pages of a repository."""
    links = [link for page in pages_of(root) for link in links_of(page)]
    judged = [(link, fault(link, root)) for link in links]
    told = [f"{link.page.relative_to(root)}:{link.line}: {link.address}: {said}" for link, said in judged if said]
    return told, sorted({link.address for link in links if "://" in link.address})


def main() -> None:
    """Print faults and addresses elsewhere."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("root", nargs="?", type=Path, default=Path(__file__).parents[1], help="the repository")
    faults, elsewhere = check(parser.parse_args().root)
    print("not opened:", *elsewhere, sep="\n  ")
    if faults:
        sys.exit("\n".join(faults))


if __name__ == "__main__":
    main()
