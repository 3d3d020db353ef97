"""The pages that are files: the style sheet and the skeleton of the HTML. No external reference."""

import base64
import hashlib
from collections.abc import Iterable, Mapping
from html import escape

from torchbrdf.report.style import STYLE


def page(title: str, body: Iterable[str], style: str = STYLE, script: str = "") -> str:
    """A whole HTML document.

    script  what it runs; a page with one may run and load nothing else, and no element may have a style of its own
    """
    policy = (
        f"default-src 'none'; script-src {source_hash(script)}; style-src {source_hash(style)}; img-src data:; "
        "base-uri 'none'; form-action 'none'"
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        + (f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n' if script else "")
        + '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{style}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(body)
        + "\n</main>\n"
        + (f"<script>{script}</script>\n" if script else "")
        + "</body>\n</html>\n"
    )


def source_hash(text: str) -> str:
    """What a Content-Security-Policy calls a script or a style sheet."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def section(title: str, *parts: str) -> str:
    """A section under a heading."""
    return f"<section>\n<h2>{escape(title)}</h2>\n" + "\n".join(parts) + "\n</section>"


def plate(inside: str, caption: str) -> str:
    """A picture on the neutral grey, with a caption (HTML)."""
    return f'<figure><div class="plate">{inside}</div><figcaption>{caption}</figcaption></figure>'


def definitions(entries: Mapping[str, str], kind: str = "") -> str:
    """Names and values, escaped; kind is a CSS class for the values."""
    rows = (f'<dt>{escape(name)}</dt><dd class="{kind}">{escape(value)}</dd>' for name, value in entries.items())
    return f"<dl>{''.join(rows)}</dl>"
