import re

from sphinx.application import Sphinx

import torchbrdf

project = "torchbrdf"
author = "the torchbrdf developers"
copyright = "the torchbrdf developers"
version = release = torchbrdf.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc"]
myst_enable_extensions = ["amsmath", "deflist", "dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]

highlight_language = "none"

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["pages.css"]
html_title = f"torchbrdf {version}"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88

_CODE = re.compile(r"(`[^`]+`)")
_SPECIAL = re.compile(r"([\\*_|])")


def _prose(lines: list[str]) -> list[str]:
    """A paragraph as reStructuredText: `names` become code, special characters are only themselves."""

    def converted(piece: str) -> str:
        return f"`{piece}`" if _CODE.fullmatch(piece) else _SPECIAL.sub(r"\\\1", piece)

    return ["".join(map(converted, _CODE.split("\n".join(lines)))), ""]


def _literal(lines: list[str]) -> list[str]:
    return ["::", "", *(f"    {line}" for line in lines), ""]


def _plain_docstring(app: object, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Our docstrings are plain text: paragraphs stay prose, and lists in columns stay as they are."""
    paragraphs = [paragraph.split("\n") for paragraph in re.split(r"\n\s*\n", "\n".join(lines).strip())]
    lines.clear()
    for paragraph in paragraphs:
        columns = any(re.match(r"\s|\S+(, \S+)*\s{2,}\S", line) for line in paragraph)
        lines += (_literal if columns else _prose)(paragraph)


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", _plain_docstring)
