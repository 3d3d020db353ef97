"""The page on which the light is turned: HTML with its style sheet and its script, page.js, inside."""

from collections.abc import Sequence
from functools import cache
from html import escape
from importlib.resources import files

from torchbrdf.report import LIVE_STYLE, plate, source_hash

_HOW = (
    "<p>Drag any sphere to turn the light: its reflections follow the pointer.</p>"
    "<dl><dt>with <kbd>Shift</kbd> or right button</dt><dd>about the view axis</dd>"
    "<dt><kbd>←</kbd> <kbd>→</kbd> <kbd>↑</kbd> <kbd>↓</kbd>, also with <kbd>Shift</kbd></dt><dd>by 5°</dd>"
    "<dt>double click or <kbd>Home</kbd></dt><dd>as it was</dd></dl>"
)


def page(title: str, light: str, labels: Sequence[str], size: int) -> str:
    """A whole HTML document.

    title   what was photographed
    light   the light's name
    labels  of the spheres, in the order of a frame, which ends with the mirror ball; the first is the result
    size    pixels along a side of each
    """

    def sphere(picture: int, label: str, note: str = "") -> str:
        canvas = (
            f'<canvas width="{size}" height="{size}" data-picture="{picture}" tabindex="0" role="application" '
            f'aria-roledescription="sphere under a light that turns" aria-label="{escape(label)}" '
            'aria-describedby="how"></canvas>'
        )
        name, bracket, remark = label.partition(" (")
        return plate(canvas, f"<b>{escape(name[:1].upper() + name[1:])}</b>{escape(bracket + remark)}{note}")

    first = (
        sphere(0, labels[0], ", the recovered BRDF"),
        sphere(len(labels), "the light", " in a mirror ball"),
        f'<div class="controls"><div id="how">{_HOW}</div>'
        '<label for="stops">Exposure <output id="exposure" for="stops">+0.00 stops</output></label>'
        '<input id="stops" type="range" min="-6" max="6" step="0.25" value="0" autocomplete="off">'
        '<button id="reset" type="button">Reset the light</button>'
        "<dl><dt>turned by</dt><dd><output id=angle>0°</output></dd><dt>speed</dt>"
        "<dd><output id=rate>–</output></dd><dt>last frame</dt><dd>no. <output id=frames>0</output>, in "
        "<output id=took>–</output></dd></dl></div>",
    )
    candidates = "".join(sphere(i, label) for i, label in enumerate(labels[1:], 1))
    second = f'<h2>Every class’s candidate</h2>\n<div class="candidates">{candidates}</div>' if candidates else ""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n<link rel="icon" href="data:,">\n'
        f"<title>{escape(title)} – torchbrdf live</title>\n<style>{LIVE_STYLE}</style>\n</head>\n<body>\n<main>\n"
        f'<h1>{escape(title)}</h1>\n<p class="soft">Under {escape(light)}. '
        "The spheres share one exposure, the mirror ball has its own.</p>\n"
        '<noscript><p class="caution">This page needs JavaScript.</p></noscript>\n'
        '<p class="caution" id="problem" role="alert" hidden></p>\n'
        f'<div class="first">{"".join(first)}</div>\n{second}\n</main>\n'
        f"<script>{_script()}</script>\n</body>\n</html>\n"
    )


@cache
def content_security_policy() -> str:
    """The header that lets the page run its own script and style, ask its own server, and nothing else."""
    script, style = source_hash(_script()), source_hash(LIVE_STYLE)
    return (
        f"default-src 'none'; script-src {script}; style-src {style}; connect-src 'self'; img-src data:; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


@cache
def _script() -> str:
    return files("torchbrdf.live").joinpath("page.js").read_text(encoding="utf-8")
