import re
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

import torchbrdf

project = "torchbrdf"
author = "the torchbrdf developers"
copyright = "the torchbrdf developers"
version = release = torchbrdf.__version__

extensions = ["myst_nb", "sphinx.ext.autodoc"]
myst_enable_extensions = ["amsmath", "deflist", "dollarmath"]
myst_heading_anchors = 3
exclude_patterns = ["_build", "**.ipynb_checkpoints"]

# Tutorials are shown as they ran (scripts/make_notebooks.py); a page that has not run yet is shown without outputs.
nb_execution_mode = "off"
nb_merge_streams = True
exclude_patterns += [f"tutorials/{path.stem}.md" for path in (Path(__file__).parent / "tutorials").glob("*.ipynb")]

highlight_language = "none"

html_theme = "furo"
html_math_renderer = "mathml"
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


def _items(lines: list[str]) -> list[str]:
    """Rows of name, perhaps shape, and description, as a definition list, which wraps where columns do not."""
    out = []
    for line in lines:
        *terms, text = re.split(r"\s{2,}", line)
        out += [" ".join(f"``{term}``" for term in terms), f"    {' '.join(_prose([text]))}".rstrip()]
    return [*out, ""]


def _paragraph(lines: list[str]) -> list[str]:
    """Prose, rows of columns whose descriptions may go on below, and what is indented, which stays as it is."""
    blocks: list[tuple[Callable[[list[str]], list[str]], list[str]]] = []
    column = 0
    for line in lines:
        row = re.match(r"\S(?:.*?\S)?\s{2,}(?=\S)", line)
        listed = bool(blocks) and blocks[-1][0] is _items
        if row or (listed and line.find(" ") == column - 1):  # a name as long as the column leaves one space
            column = row.end() if row else column
            kind, text = _items, line if row else f"{line[:column]} {line[column:]}"
        elif listed and line[:1] == " ":
            blocks[-1][1][-1] += f" {line.strip()}"
            continue
        else:
            kind, text = (_literal if line[:1] == " " else _prose), line
        if not blocks or blocks[-1][0] is not kind:
            blocks.append((kind, []))
        blocks[-1][1].append(text)
    return [line for kind, block in blocks for line in kind(block)]


def _plain_docstring(app: object, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Our docstrings are plain text: as reStructuredText, paragraph by paragraph."""
    paragraphs = [paragraph.split("\n") for paragraph in re.split(r"\n\s*\n", "\n".join(lines).strip())]
    lines[:] = [line for paragraph in paragraphs for line in _paragraph(paragraph)]


def _inline_math(self: HTML5Translator, node: nodes.math) -> NoReturn:
    """A formula in the browser's own language: the pages show it without the network."""
    self.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def _displayed_math(self: HTML5Translator, node: nodes.math_block) -> NoReturn:
    """As above; what MathML has no word for, the number of an equation, stands behind it."""
    formula = tex2mathml(re.sub(r"\\tag\{([^}]+)\}", r"\\qquad \\text{(\1)}", node.astext()), as_block=True)
    self.body.append(f'<div class="math">{formula}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.add_html_math_renderer("mathml", (_inline_math, None), (_displayed_math, None))
    app.connect("autodoc-process-docstring", _plain_docstring)
