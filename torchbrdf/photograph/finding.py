"""Where balls are in a whole photograph, from their outlines alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import hypot, pi, prod
from operator import attrgetter

import numpy as np
import torch
from torch import Tensor

from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.photograph._candidates import Place, seek
from torchbrdf.photograph._charts import Chart, chart_of
from torchbrdf.photograph._checks import check_photograph
from torchbrdf.photograph._mirror import settled
from torchbrdf.photograph._outline import LEAST_STD, Outline
from torchbrdf.photograph._pyramid import Pyramid
from torchbrdf.photograph.silhouette import Circle

FITTED_RADIUS = 32
"""Pixels of the ball's radius in which deviations are told: of a photograph at 64 x 64."""

_CANDIDATES, _FIRST, _LIKELY = 32, 4, 10
_FLOOR = 0.05
"""Of the median radiance: smaller differences are noise."""

_ROUGH_RADIUS, _ROUGH_REACH, _ROUGH_RAYS = 40, 0.12, 96
_FINE_RADIUS, _FINE_RAYS = 128, 300
_STAGES: tuple[tuple[float, tuple[float, ...]], ...] = ((0.07, (0.7, 1.2)), (0.03, (0.45, 0.6, 0.8, 1.05, 1.4, 1.85)))
"""How far the outline may move, in radii, and how blurred it may be, in pixels."""

_LEAST_REACH = 3.0
_HOPELESS = 0.15
"""Score below which an outline is not refined."""

_SAME, _COVERED = 0.03, 0.5
"""In radii, how near two starts are the same; the share of a circle that may lie in a better one."""

_DEEP, _NEARLY_AS_GOOD = 0.8, 0.5
"""Ratios of radii and of scores: a circle that lies in another is seen in it, and is not before it."""

_ROOM, _UNSURE = 0.7, 0.3
"""Where only what is sure is of interest: ratios of the radius, and of the share of the rim and the score, that an
outline has before it is refined."""

_LEAST_RIM = 0.3
_SURE: tuple[tuple[float, float], ...] = ((0.45, 0.7), (0.5, 0.5))
"""Shares of the rim and scores of which one or the other is enough."""

_MOST_STD, _MOST_ELLIPSE, _MOST_DOUBT = 0.5, 0.35, 0.35
"""In pixels of FITTED_RADIUS."""

_CERTAIN = 2.5
"""Standard deviations."""

_EDGE_POINTS = 128

_AROUND = 1.5
"""Radii about a guess that are looked at: as far as it may be off, and what is beside the ball there."""


@dataclass(frozen=True)
class FoundBall:
    """A ball in a photograph.

    silhouette  a circle, or a ball before the camera where that is known
    std         of x, y and radius: standard deviations in pixels of the photograph
    rim         share of its rim that is seen as an edge
    outside     share of its disc that the photograph's border cuts off
    score       by how much likelier than elsewhere its rim is there: the mean of a logarithm
    edge        (n, 2): what is seen as its outline, in pixels, an ellipse that need be no ball's
    flattened   by how much that leaves a ball's, in pixels, and the standard deviation
    doubt       by how much models of what is seen at its rim disagree on x, y or radius, in pixels
    """

    silhouette: Circle | Ball
    std: tuple[float, float, float]
    rim: float
    outside: float
    score: float
    edge: Tensor
    flattened: tuple[float, float]
    doubt: float

    def __str__(self) -> str:
        """For people."""
        return f"{self.silhouette}, {self.rim:.0%} of its rim seen"

    @cached_property
    def circle(self) -> Circle:
        """With the centre and the area of the silhouette."""
        return Circle(*self.silhouette.circle)

    @property
    def round(self) -> bool:
        """Whether it may be the outline of a ball, before the camera that was given."""
        amplitude, std = self.flattened
        return amplitude <= max(_MOST_ELLIPSE * self.circle.radius / FITTED_RADIUS, _CERTAIN * std)

    @property
    def sure(self) -> bool:
        """Whether enough of the rim is seen, and agrees."""
        inside = 1 - self.outside
        enough = any(self.rim >= rim * inside and self.score >= score * inside for rim, score in _SURE)
        unit = self.circle.radius / FITTED_RADIUS
        agreed = self.doubt <= _MOST_DOUBT * unit or not self.round  # on no circle can models of one agree
        return enough and max(self.std) <= _MOST_STD * unit and agreed


def find_balls(image: Tensor, camera: PinholeCamera | None = None, usable: Tensor | None = None) -> list[FoundBall]:
    """What may be balls in a photograph, the largest first.

    image   (3, H, W)  linear radiance
    camera  of the whole photograph; None where it is not known: outlines are circles
    usable  (1, H, W)  bool, True = use; None uses all that is finite
    Edges vote for circles in a plane where outlines are circles. Each is fitted to edges across its rim, coarsely and
    then finely; of those that overlap the best is kept, and settled by what goes on across it where edges say little.
    Background, reflections, stands and shadows weaken an outline and do not move it. Not all are `sure`. Raises
    ValueError where image or usable is not of these shapes.
    """
    check_photograph(image, usable)
    return balls_of(Pyramid.of(image, usable), camera)


def balls_of(pyramid: Pyramid, camera: PinholeCamera | None) -> list[FoundBall]:
    """`find_balls`, in a photograph at several sizes."""
    chart = chart_of(camera)
    kept = [settled(outline, pyramid, chart, _FINE_RADIUS) for outline in _outermost(list(_seen(pyramid, chart)))]
    found = [one for outline in kept if (one := _found(outline, chart, pyramid.size)) is not None]
    return sorted(found, key=lambda one: -one.circle.radius)


def find_near(image: Tensor, guess: Circle | Ball, usable: Tensor | None = None) -> FoundBall | None:
    """The ball of which a first guess is known, by its outline alone; None where that is not seen for certain.

    guess  within about a tenth of the radius; a ball before the photograph's camera
    See `find_balls`.
    """
    check_photograph(image, usable)
    chart = chart_of(guess.camera if isinstance(guess, Ball) else None)
    place = chart.circle(guess)
    height, width = image.shape[-2:]
    x, y, radius = guess.circle
    left, top = (max(int(middle - _AROUND * radius), 0) for middle in (x, y))
    around = slice(top, int(y + _AROUND * radius) + 1), slice(left, int(x + _AROUND * radius) + 1)
    pyramid = Pyramid.of(image.detach()[:, *around], None if usable is None else usable[:, *around], (left, top))
    floor = _floor(pyramid)
    if floor is None:
        return None
    rough = _roughly(pyramid, chart, place, floor)
    starts = [place] if rough is None or _alike(rough.place, place) else [place, rough.place]
    refined = [outline for start in starts if (outline := _refined(pyramid, chart, start)) is not None]
    if not refined:
        return None
    found = _found(max(refined, key=attrgetter("score")), chart, (height, width))
    return found if found is not None and found.sure and found.round else None


def _floor(pyramid: Pyramid) -> float | None:
    """Radiance by which differences are noise, whatever is black; None where there is nothing to see."""
    coarsest = pyramid.levels[-1]
    lit = coarsest[np.isfinite(coarsest) & (coarsest > 0)]
    return _FLOOR * float(np.median(lit)) if lit.size else None


def any_sure(pyramid: Pyramid) -> bool:
    """Whether any circle is `sure`, be there a better one over it: what is too small for that is not refined."""
    chart, least = chart_of(None), FITTED_RADIUS * LEAST_STD / _MOST_STD
    for outline in _seen(pyramid, chart, least):
        found = _found(settled(outline, pyramid, chart, _FINE_RADIUS), chart, pyramid.size)
        if found is not None and found.sure:
            return True
    return False


def _seen(pyramid: Pyramid, chart: Chart, least: float = 0.0) -> Iterator[Outline]:
    """The refined outlines of which enough is seen.

    least  radius in pixels of the chart of what is of interest, and only where it may be `sure`; 0 for all
    """
    floor = _floor(pyramid)
    if floor is None:
        return
    for place in _starts(pyramid, chart, floor, least):
        outline = _refined(pyramid, chart, place, least)
        if outline is not None and outline.share >= _LEAST_RIM * outline.seen:
            yield outline


def _starts(pyramid: Pyramid, chart: Chart, floor: float, least: float) -> list[Place]:
    """From where to refine: the likeliest circles, and the best of all after a rough fit."""
    places = [place for place in seek(pyramid, chart, floor, _CANDIDATES) if place[2] > _ROOM * least]
    rough = [_roughly(pyramid, chart, place, floor) for place in places]
    likely = [one.place for one in _distinct([one for one in rough if one is not None])[:_LIKELY]]
    return likely + [place for place in places[:_FIRST] if not any(_alike(place, one) for one in likely)]


def _roughly(pyramid: Pyramid, chart: Chart, place: Place, floor: float) -> Outline | None:
    """The outline about a place; None where there is none."""
    return Outline.near(pyramid, chart, place, wanted=_ROUGH_RADIUS, reach=_ROUGH_REACH, n=_ROUGH_RAYS, floor=floor)


def _refined(pyramid: Pyramid, chart: Chart, place: Place, least: float = 0.0) -> Outline | None:
    """The outline near a place; None where there is none, or none that is of interest (see `_seen`)."""
    for reach, blurs in _STAGES:
        radius = min(place[2], _FINE_RADIUS)
        n = int(min(_FINE_RAYS, 2 * pi * radius))
        farthest = max(reach, _LEAST_REACH / radius)
        outline = Outline.near(pyramid, chart, place, wanted=_FINE_RADIUS, reach=farthest, n=n, blurs=blurs)
        if outline is None or outline.score < _HOPELESS:
            return None
        if least > 0 and not _may_become_sure(outline, least, pyramid.size):
            return None
        place = outline.place
    return outline


def _may_become_sure(outline: Outline, least: float, size: tuple[int, int]) -> bool:
    """Whether a photograph's outline has about the radius that is of interest, and a part of what makes it sure."""
    x, y, radius = outline.place
    height, width = size
    across = (max(min(at + radius, side) - max(at - radius, 0), 0) for at, side in ((x, width), (y, height)))
    inside = _UNSURE * prod(across) / (2 * radius) ** 2
    enough = any(outline.share >= rim * inside and outline.score >= score * inside for rim, score in _SURE)
    return enough and radius >= _ROOM * least


def _found(outline: Outline, chart: Chart, size: tuple[int, int]) -> FoundBall | None:
    """In the photograph; None where it has become smaller than a ball may be."""
    x, y, radius = outline.place
    try:
        silhouette = chart.silhouette(x, y, radius)
    except ValueError:
        return None
    std_x, std_y, std_radius = (radius * outline.std).tolist()
    ellipse = outline.ellipse
    edge = torch.from_numpy(chart.to_photograph(ellipse.points(_EDGE_POINTS)))
    return FoundBall(
        silhouette,
        (std_x, std_y, std_radius),
        outline.share,
        _outside(silhouette, size),
        outline.score,
        edge,
        (radius * ellipse.amplitude, radius * ellipse.std),
        radius * outline.doubt,
    )


def _distinct(outlines: list[Outline]) -> list[Outline]:
    """The best of those that are the same, best first."""
    kept: list[Outline] = []
    for outline in sorted(outlines, key=lambda one: -one.score):
        if not any(_alike(outline.place, other.place) for other in kept):
            kept.append(outline)
    return kept


def _outermost(outlines: list[Outline]) -> list[Outline]:
    """The best of those that overlap; but what lies deep in another that is nearly as good is a reflection in it."""
    kept: list[Outline] = []
    for outline in sorted(outlines, key=lambda one: -one.score):
        over = [other for other in kept if _covered(outline.place, other.place)]
        if all(
            other.place[2] < _DEEP * outline.place[2] and outline.score > _NEARLY_AS_GOOD * other.score
            for other in over
        ):
            kept = [*(other for other in kept if other not in over), outline]
    return kept


def _differ(a: Place, b: Place) -> float:
    return max(abs(p - q) for p, q in zip(a, b, strict=True)) / min(a[2], b[2])


def _alike(a: Place, b: Place) -> bool:
    return _differ(a, b) < _SAME


def _covered(a: Place, b: Place) -> bool:
    """Whether much of the smaller lies in the larger."""
    small, large = sorted((a, b), key=lambda one: one[2])
    distance = hypot(small[0] - large[0], small[1] - large[1])
    return distance + small[2] * (2 * _COVERED - 1) < large[2]


def _outside(silhouette: Circle | Ball, size: tuple[int, int]) -> float:
    """Share of a disc beyond the photograph's border."""
    middle_x, middle_y, radius = silhouette.circle
    across = torch.linspace(-1, 1, 101, dtype=torch.float32)
    x, y = torch.meshgrid(across, across, indexing="xy")
    disc = x**2 + y**2 <= 1
    x, y = middle_x + radius * x[disc], middle_y + radius * y[disc]
    return float(((x < 0) | (y < 0) | (x > size[1]) | (y > size[0])).float().mean())
