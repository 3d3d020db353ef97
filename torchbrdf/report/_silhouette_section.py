"""The whole photograph, with the silhouette that was found drawn on it."""

from dataclasses import dataclass
from html import escape
from math import ceil

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from torchbrdf.images import exposure_for
from torchbrdf.report._figures import picture
from torchbrdf.report.page import plate, section

_WIDEST = 720
"""Pixels along a side of a picture, at most."""

_AROUND = 0.15
"""Of the ball's width: what the enlarged picture shows around it."""

_MUCH_LARGER = 2.0
"""Photographs so many times as wide as the ball are shown whole, too."""


@dataclass(frozen=True, eq=False)
class Scene:
    """What the camera recorded, and where the ball is in it.

    photograph  (3, H, W)  linear radiance; NaN where nothing is known
    outline     (n, 2)     points of the silhouette, x to the right and y down, in pixels
    about       how it was found, for people
    """

    photograph: Tensor
    outline: Tensor
    about: str


def silhouette_section(scene: Scene) -> str:
    """The photograph where it shows much else, and the ball enlarged, both with the outline."""
    height, width = scene.photograph.shape[-2:]
    low, high = scene.outline.amin(0), scene.outline.amax(0)
    across = float((high - low).max())
    left, top = (max(0, int(start)) for start in (low - _AROUND * across).tolist())
    right, bottom = (
        min(n, ceil(stop)) for stop, n in zip((high + _AROUND * across).tolist(), (width, height), strict=True)
    )
    near = slice(top, bottom), slice(left, right)
    around = scene.photograph[:, *near].nan_to_num(0.0, 0.0, 0.0)
    exposure = exposure_for(around, torch.ones_like(around[:1], dtype=torch.bool))
    plates = [_outlined(scene, *near, "The ball", exposure)]
    if max(height, width) > _MUCH_LARGER * across:
        plates.insert(0, _outlined(scene, slice(0, height), slice(0, width), "The whole photograph", exposure))
    shown = "shown with" if len(plates) == 1 else "both shown with"
    note = (
        f"The yellow line should run along the ball’s edge; {shown} exposure × {exposure:.3g}, at which the 99th "
        "percentile of the ball and what lies around it is white."
    )
    return section(
        "Where the ball is",
        f"<p>{escape(scene.about[:1].upper() + scene.about[1:])}.</p>",
        f'<div class="outlined">{"".join(plates)}</div>',
        f'<p class="note">{note}</p>',
    )


def _outlined(scene: Scene, rows: slice, columns: slice, caption: str, exposure: float) -> str:
    """A part of the photograph, made smaller by whole pixels, under the outline."""
    part = scene.photograph[:, rows, columns]
    part = part.nan_to_num(0.0, float(part[part.isfinite()].amax()), 0.0)
    step = ceil(max(part.shape[1:]) / _WIDEST)
    shown = avg_pool2d(part, step, ceil_mode=True, count_include_pad=False)
    _, height, width = part.shape
    points = " ".join(f"{x - columns.start:.2f},{y - rows.start:.2f}" for x, y in scene.outline.tolist())
    lines = f'<svg viewBox="0 0 {width} {height}" aria-hidden="true"><polygon points="{points}"/></svg>'
    return plate(f'<div class="under">{picture(shown, caption, exposure)}{lines}</div>', f"<b>{caption}</b>")
