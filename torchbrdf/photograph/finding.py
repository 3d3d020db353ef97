"""Where balls are in a whole photograph, from their outlines alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import hypot, pi

import numpy as np
import torch
from torch import Tensor

from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.photograph._candidates import Place, seek
from torchbrdf.photograph._charts import chart_of
from torchbrdf.photograph._outline import Outline
from torchbrdf.photograph._pyramid import Pyramid
from torchbrdf.photograph.silhouette import Circle

_CANDIDATES = 40
_REFINED = 10
_FLOOR = 0.05
"""Of the median radiance: smaller differences are noise."""

_APART = 0.1
_COVERED = 0.5
"""Share of a circle that may lie in a better one."""

_BLURS = (0.45, 0.6, 0.8, 1.05, 1.4, 1.85)
_RAYS = 360
_FINE_RADIUS = 128

_LEAST_SHARE, _SURE_SHARE = 0.4, 0.5
_SURE_SCORE = 0.8
_MOST_STD = 0.15

FITTED = 64
"""Pixels across a ball in which deviations are told."""


@dataclass(frozen=True)
class FoundBall:
    """A ball in a photograph.

    silhouette  a circle, or a ball before the camera where that is known
    std         (x, y, radius): standard deviations in pixels of the photograph, from how parts of the rim disagree
    rim         share of the rim that is seen as an edge
    outside     share of the ball's disc that the photograph's border cuts off
    score       by how much likelier than anywhere the outline is there, mean of a logarithm over the rim
    ellipse     by how many pixels of the ball's radius the outline is an ellipse beyond what the camera gives one, and
                the standard deviation of that
    """

    silhouette: Circle | Ball
    std: tuple[float, float, float]
    rim: float
    outside: float
    score: float
    ellipse: tuple[float, float]

    def __str__(self) -> str:
        """For people."""
        return f"{self.silhouette}, {self.rim:.0%} of its rim seen"

    @cached_property
    def circle(self) -> Circle:
        """With the centre and the area of the silhouette."""
        return self.silhouette if isinstance(self.silhouette, Circle) else Circle(*self.silhouette.circle)

    @property
    def sure(self) -> bool:
        """Whether it is a ball beyond doubt."""
        return self.rim >= _SURE_SHARE * (1 - self.outside) and self.score >= _SURE_SCORE and (
            max(self.std) <= _MOST_STD * 2 * self.circle.radius / FITTED
        )


def find_balls(image: Tensor, camera: PinholeCamera | None = None, usable: Tensor | None = None) -> list[FoundBall]:
    """What may be balls in a photograph, the largest first.

    image   (3, H, W)  linear radiance
    camera  of the whole photograph; None for balls near the axis of any, whose outlines are circles
    usable  (1, H, W)  bool, True = use; None uses all that is finite
    Edges vote for circles in a plane where outlines are circles; each is fitted to edges across its rim, coarsely and
    finely, and the best of those that overlap are kept. Background, what the balls reflect, stands and shadows only
    weaken them. Check `sure`, and see `the_ball`.
    """
    pyramid, chart = Pyramid.of(image, usable), chart_of(camera)
    coarsest = pyramid.levels[-1]
    known = coarsest[np.isfinite(coarsest).all(-1)]
    floor = _FLOOR * float(np.median(known)) if known.size else 0.0
    if floor <= 0:
        return []
    outlines = []
    for place in seek(pyramid, chart, floor, _CANDIDATES):
        rough = Outline.near(pyramid, chart, place, wanted=40, reach=0.12, n=96, floor=floor)
        if rough is not None:
            rough = Outline.near(pyramid, chart, rough.place, wanted=48, reach=0.06, n=128, floor=floor)
        if rough is not None:
            outlines.append(rough)
    refined = []
    for rough in _distinct(outlines, _alike)[:_REFINED]:
        radius = min(rough.place[2], _FINE_RADIUS)
        fine = Outline.near(
            pyramid, chart, rough.place, wanted=_FINE_RADIUS, reach=max(0.03, 3 / radius),
            n=int(min(_RAYS, 2 * pi * radius)), blurs=_BLURS,
        )  # fmt: skip
        if fine is not None and fine.share >= _LEAST_SHARE * fine.seen:
            refined.append(fine)
    found = []
    for outline in _distinct(refined, _covered):
        x, y, radius = outline.place
        silhouette = chart.silhouette(x, y, radius)
        std_x, std_y, std_radius = (radius * outline.std).tolist()
        amplitude, uncertain = (radius * each for each in outline.ellipse)
        outside = _outside(silhouette, pyramid.size)
        found.append(
            FoundBall(silhouette, (std_x, std_y, std_radius), outline.share, outside, outline.score, (amplitude, uncertain))
        )
    return sorted(found, key=lambda one: -one.circle.radius)


def _distinct(outlines: list[Outline], same) -> list[Outline]:
    """The best of those that are the same, best first."""
    kept: list[Outline] = []
    for outline in sorted(outlines, key=lambda one: -one.score):
        if not any(same(outline.place, other.place) for other in kept):
            kept.append(outline)
    return kept


def _alike(a: Place, b: Place) -> bool:
    return max(abs(p - q) for p, q in zip(a, b, strict=True)) < _APART * min(a[2], b[2])


def _covered(a: Place, b: Place) -> bool:
    """Whether much of the smaller lies in the larger."""
    small, large = sorted((a, b), key=lambda one: one[2])
    distance = hypot(small[0] - large[0], small[1] - large[1])
    return distance + small[2] * (2 * _COVERED - 1) < large[2]


def _outside(silhouette: Circle | Ball, size: tuple[int, int]) -> float:
    """Share of the disc beyond the photograph's border."""
    x, y, r = (silhouette.x, silhouette.y, silhouette.radius) if isinstance(silhouette, Circle) else silhouette.circle
    across = torch.linspace(-1, 1, 101)
    dx, dy = torch.meshgrid(across, across, indexing="xy")
    disc = dx**2 + dy**2 <= 1
    px, py = x + r * dx[disc], y + r * dy[disc]
    return float(((px < 0) | (py < 0) | (px > size[1]) | (py > size[0])).float().mean())
