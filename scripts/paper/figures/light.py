"""`Light`: what balls are shown under, a probe or one direction; its exposure and the labels of pictures under it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath

from torch import Tensor

import torchbrdf as tb
from paper.figures.sheet import Cell, Row, Tile, sphere_tile
from torchbrdf.experiments import common_exposure
from torchbrdf.images import relative_rms, tone_map

DIRECTIONAL = (0, 136)
"""Angles of the lights of [CBP21, fig. 2] in degrees from the camera; `render_directional` says about which axis."""


@dataclass(frozen=True, eq=False)
class Light:
    """A probe, or the angle of a directional light in degrees."""

    source: tb.LightProbe | int

    @property
    def name(self) -> str:
        """The name of the probe's file, or the angle."""
        if isinstance(self.source, int):
            return f"light at {self.source}°"
        return PurePath(self.source.name.removeprefix("light probe ").removesuffix(" light probe")).stem

    def exposure(self, references: Sequence[Tensor]) -> float:
        """Of all pictures that belong to some references: 1 under a directional light, which is of known strength."""
        return 1.0 if isinstance(self.source, int) else common_exposure(references)

    def label(self, scale: float) -> str:
        """Name and exposure."""
        return self.name if isinstance(self.source, int) else f"{self.name}, exposure {scale:.2g}"

    def caption(self, image: Tensor, reference: Tensor) -> str:
        """The error of an image (3, T, T) of a ball.

        Under a directional light, where a highlight outweighs all else, also that of what the picture displays.
        """
        caption = percent(ball_error(image, reference))
        if isinstance(self.source, int):
            caption += f" ({percent(ball_error(tone_map(image), tone_map(reference)))})"
        return caption

    def row(self, label: str, images: Sequence[Tensor], references: Sequence[Tensor], scale: float) -> Row:
        """Pictures with their errors under them; where an image is its own reference there is none."""
        cells: list[Cell] = []
        for image, reference in zip(images, references, strict=True):
            caption = "" if image is reference else self.caption(image, reference)
            cells.append(Tile(sphere_tile(image, scale), caption))
        return Row(label, cells)


def ball_error(image: Tensor, reference: Tensor) -> float:
    """|image - reference| / |reference| over channels and pixels of a SphereView."""
    return relative_rms(image, reference, tb.SphereView(image.shape[-1]).mask)


def percent(share: float) -> str:
    """With one decimal below 10 %."""
    return f"{100 * share:.1f} %" if share < 0.0995 else f"{100 * share:.0f} %"
