"""The part of a comparison in which the light is turned: spheres drawn by WebGL in the viewer's browser."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib.resources import files

import torch
from torch import Tensor

from torchbrdf.brdf import MerlTable, brdf_texture
from torchbrdf.images import LUMINANCE, stops_for
from torchbrdf.rendering import directional_pictures
from torchbrdf.report._figures import CHANNEL_COLOURS, DIVERGING, SEQUENTIAL, gradient_css
from torchbrdf.report._pictures import ball
from torchbrdf.report.page import page, plate, section
from torchbrdf.report.style import LIVE_STYLE
from torchbrdf.view import SphereView

COMPARE_STYLE = (
    LIVE_STYLE
    + f"""
main {{ padding-top: 40px; }}
h2 {{ margin-top: 44px; }}
h3 {{ font-size: 15px; font-weight: 400; margin: 20px 0 8px; }}
.scale {{ background: {gradient_css(DIVERGING)}; }} .scale.steps {{ background: {gradient_css(SEQUENTIAL)}; }}
.key .r {{ border-color: {CHANNEL_COLOURS[0]}; }} .key .g {{ border-color: {CHANNEL_COLOURS[1]}; }}
.key .b {{ border-color: {CHANNEL_COLOURS[2]}; }}
"""
    + """
[hidden] { display: none !important; }
.first-line { border-top: 1px dashed #444 !important; }
svg.polar text { font-size: 9px; }
.three figcaption, .four figcaption { font-size: 13px; }
.three .plate, .four .plate { aspect-ratio: auto; }
.plate img.disc { width: 100%; }
.plate + figcaption { min-height: 2.8em; overflow-wrap: anywhere; }
.three + .three, .four + .four, .three + .note, .four + .note { margin-top: 14px; }
.controls.wide { grid-column: 1 / -1; padding: 0; display: grid; gap: 0 40px;
  grid-template-columns: repeat(2, minmax(0, 1fr)); }
.controls fieldset { border: 0; margin: 0 0 12px; padding: 0; }
.controls fieldset label { display: inline-block; margin-right: 14px; }
.controls fieldset input { width: auto; margin: 0 6px 0 0; }
.numbers td, .numbers th { text-align: right; padding-right: 0; padding-left: 22px; }
.numbers td:first-child, .numbers th:first-child { text-align: left; padding-left: 0; overflow-wrap: anywhere; }
@media (max-width: 640px) { main { padding-left: 16px; padding-right: 16px; } .plate { padding: 10px; }
  .controls, .controls.wide { grid-column: 1 / -1; padding: 0; display: block; }
  table.numbers { display: block; overflow-x: auto; } .numbers td:first-child { white-space: nowrap; } }
@media print { .controls, #problem { display: none; } }
"""
)

LIGHT = (0.5, 0.5, 0.5**0.5)
"""Towards the light at first: 45 degrees from the camera, from above right."""

DIFFERENCE_RANGE = 0.5
"""Luminance, in units of white, at the ends of the difference's colours."""


@dataclass(frozen=True, eq=False)
class TurnedSpheres:
    """What the browser draws, and what it looks like before.

    names   of the tables; the first is the reference
    stills  (K, 3, N, N)  radiance under a directional light of irradiance pi from `LIGHT`
    gain    what takes radiance to the screen's white at +0 stops
    """

    names: Sequence[str]
    tables: Sequence[MerlTable]
    stills: Tensor
    gain: float

    @classmethod
    def of(cls, names: Sequence[str], tables: Sequence[MerlTable], size: int) -> "TurnedSpheres":
        """Render the stills, at an exposure that suits what lies beside the highlight of the brightest."""
        view, light = SphereView(size), torch.tensor(LIGHT)
        stills = directional_pictures(tables, view, direction=light, irradiance=torch.pi)
        gain = min((stops_for(still)[1] for still in stills if still.any()), default=1.0)
        return cls(names, tables, stills, gain)

    def section(self) -> str:
        """HTML of the section; `compare_document` adds the script."""
        packed = [brdf_texture(table) for table in self.tables]
        size = self.stills.shape[-1]
        view = SphereView(size)
        figures, texts = [], []
        for i, (name, still, (texture, scale)) in enumerate(zip(self.names, self.stills, packed, strict=True)):
            canvas = (
                f'<canvas width="{size}" height="{size}" data-scale="{scale}" tabindex="0" role="application" hidden '
                'aria-roledescription="sphere under a light that turns" aria-describedby="how" '
                f'aria-label="{escape(name)}"></canvas>'
            )
            picture = ball(still, view, self.gain, f"{name} under a directional light from above right", "")
            figures.append(plate(picture + canvas, f"<b>{escape(name)}</b>"))
            data = base64.b64encode(texture.tobytes()).decode()
            texts.append(f'<script type="text/plain" id="table-{i}">{data}</script>')
        depth, height, width, _ = packed[0][0].shape
        colours = ",".join(str(value) for colour in DIVERGING for value in colour)
        few = len(figures) < 3
        return section(
            "Under a light that you turn",
            "<p>A directional light of irradiance π: at exposure × 1 a white diffuse surface that faces it just "
            "reaches white. At first it comes from above right, 45° from the camera, and exposure is "
            f"×&nbsp;{self.gain:g}.</p>",
            '<noscript><p class="caution">Without JavaScript the light stays where it is.</p></noscript>',
            '<p class="caution" id="problem" role="alert" hidden></p>',
            f'<div id="turn" class="{"three" if len(figures) <= 3 else "four"}" data-gain="{self.gain}" '
            f'data-light="{",".join(str(value) for value in LIGHT)}" data-range="{DIFFERENCE_RANGE}" '
            f'data-texture="{width},{height},{depth}" data-colours="{colours}" '
            f'data-brightness="{",".join(map(str, LUMINANCE))}">'
            f"{''.join(figures)}{_controls(self.names[0], '' if few else ' wide')}</div>",
            *texts,
        )


def compare_document(title: str, body: Sequence[str]) -> str:
    """A whole HTML document with the script that turns the light."""
    return page(title, body, COMPARE_STYLE, _script())


def _controls(first: str, kind: str) -> str:
    return (
        f'<div class="controls{kind}" id="controls" hidden><div id="how"><p>Press or drag on any sphere: the highlight '
        "goes there.</p><dl><dt><kbd>←</kbd> <kbd>→</kbd> <kbd>↑</kbd> <kbd>↓</kbd></dt><dd>turn the light by 5°</dd>"
        "<dt>with <kbd>Shift</kbd></dt><dd>about the view axis</dd>"
        "<dt>double click or <kbd>Home</kbd></dt><dd>as it was</dd></dl></div><div>"
        '<label for="stops">Exposure <output id="exposure" for="stops">+0.00 stops</output></label>'
        '<input id="stops" type="range" min="-10" max="10" step="0.25" value="0" autocomplete="off">'
        '<fieldset><label><input type="radio" name="show" id="radiance" checked autocomplete="off">radiance</label>'
        '<label><input type="radio" name="show" id="difference" autocomplete="off">difference from '
        f"{escape(first)}</label>"
        f'<div id="scale" hidden><div class="scale"></div><div class="ends"><span>−{DIFFERENCE_RANGE:.0%} of white'
        f"</span><span>0</span><span>+{DIFFERENCE_RANGE:.0%}</span></div></div></fieldset>"
        '<button id="reset" type="button">Reset the light</button>'
        "<dl><dt>light, from the camera</dt><dd><output id=angle>45°</output></dd>"
        "<dt>clockwise from the top</dt><dd><output id=around>45°</output></dd>"
        "<dt>pictures drawn</dt><dd><output id=frames>0</output></dd></dl></div></div>"
    )


@cache
def _script() -> str:
    return files("torchbrdf.report").joinpath("turned_spheres.js").read_text(encoding="utf-8")
