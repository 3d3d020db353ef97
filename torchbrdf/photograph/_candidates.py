"""Where balls may be: edges vote for the middles of circles of all sizes [DH72]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from torchbrdf.photograph._charts import Chart
from torchbrdf.photograph._pyramid import Pyramid

Place = tuple[float, float, float]
"""x, y and radius of a circle in a chart."""

_SIDE, _FINEST = 320, 8 / 3
"""Pixels along the longer side of the picture in which candidates are sought, and at most to one of the photograph: the
least radius is 3 of those."""

_LEAST, _MOST, _STEP = 8.0, 0.75, 1.05
"""Radii: the least in its pixels, the most in shorter sides, and their ratio."""

_OUTSIDE = 0.25
"""How far beyond the border middles may lie, in radii."""

_SPREAD = 0.04
"""Of the votes for a middle, in radii."""

_FAINTEST = 0.02
"""The slope of log radiance that counts half, where all around is smooth."""

_NEIGHBOURHOOD = 0.03
"""Of the longer side: within which an edge is compared with others."""

_PER_RADIUS = 12
_APART = 0.12


def seek(pyramid: Pyramid, chart: Chart, floor: float, most: int) -> list[Place]:
    """The likeliest circles of a chart, the likeliest first.

    floor  radiance that is added before the logarithm: what differs by less is noise
    """
    left, top, right, bottom = chart.extent(pyramid.size)
    step = max(right - left, bottom - top) / min(_SIDE, _FINEST * max(pyramid.size))
    columns, rows = (np.arange(round((high - low) / step)) + 0.5 for low, high in ((left, right), (top, bottom)))
    points = np.stack(np.meshgrid(left + step * columns, top + step * rows), -1)
    picture = np.log(np.maximum(pyramid.sampled(chart.to_photograph(points), pyramid.level(step, 1)), 0) + floor)
    edges = _Edges.of(picture)
    shorter = min(picture.shape[:2])
    radii = _LEAST * _STEP ** np.arange(max(int(np.log(_MOST * shorter / _LEAST) / np.log(_STEP)) + 1, 0))
    every = [found for radius in radii for found in edges.middles(float(radius))]
    kept: list[tuple[float, float, float]] = []
    for _, x, y, radius in sorted(every, reverse=True):
        if all(
            max(abs(x - other[0]), abs(y - other[1]), abs(radius - other[2])) > _APART * min(radius, other[2])
            for other in kept
        ):
            kept.append((x, y, radius))
            if len(kept) == most:
                break
    return [(left + step * x, top + step * y, step * radius) for x, y, radius in kept]


@dataclass(frozen=True)
class _Edges:
    """Ridges of the gradient of a picture (H, W): row, column, unit vector across (x, y), weight from 0 to 1."""

    size: tuple[int, int]
    rows: np.ndarray
    columns: np.ndarray
    x: np.ndarray
    y: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, picture: np.ndarray) -> _Edges:
        """Of a picture (H, W, 3), NaN where it is not known; of the channel whose gradient is steepest."""
        import cv2

        height, width = picture.shape[:2]
        known = np.isfinite(picture).all(-1)
        well = cv2.erode(np.pad(known, 1).astype(np.uint8), np.ones((7, 7), np.uint8))[1:-1, 1:-1].astype(bool)
        smooth = cv2.GaussianBlur(np.where(known[..., None], picture, 0).astype(np.float32), (0, 0), 1.0)
        slopes = np.stack([cv2.Sobel(smooth, cv2.CV_32F, *order) / 8 for order in ((1, 0), (0, 1))])
        steepest = (slopes**2).sum(0).argmax(-1)[None, ..., None]
        x, y = np.take_along_axis(slopes, steepest, -1)[..., 0]
        slope = np.hypot(x, y)
        x, y = x / (slope + 1e-12), y / (slope + 1e-12)
        down, right = np.mgrid[0:height, 0:width].astype(np.float32)
        ahead, behind = (cv2.remap(slope, right + sign * x, down + sign * y, cv2.INTER_LINEAR) for sign in (1, -1))
        usual = 0.5 * cv2.GaussianBlur(slope, (0, 0), _NEIGHBOURHOOD * max(height, width)) + _FAINTEST
        ridge = well & (slope >= ahead) & (slope > behind) & (slope > 0.3 * usual)
        rows, columns = np.nonzero(ridge)
        return cls((height, width), rows, columns, x[ridge], y[ridge], (slope / (slope + usual))[ridge])

    def middles(self, radius: float) -> list[tuple[float, float, float, float]]:
        """Score, x, y and radius of the likeliest circles of a radius.

        The score is of votes across the edges beyond those along them, which are as many where edges are no circles.
        """
        import cv2

        margin = int(_OUTSIDE * radius) + 2
        sigma = max(_SPREAD * radius, 0.7)
        across = self._votes(radius * self.x, radius * self.y, margin)
        along = self._votes(-radius * self.y, radius * self.x, margin)
        near, usual = (
            cv2.GaussianBlur(votes, (0, 0), spread, borderType=cv2.BORDER_CONSTANT)
            for votes, spread in ((across, sigma), (along, 3 * sigma))
        )
        score = (near - usual) * 4 * np.pi * sigma**2 / (2 * np.pi * radius) ** 0.7
        y, x = np.nonzero((score == cv2.dilate(score, np.ones((3, 3), np.uint8))) & (score > 0))
        best = np.argsort(-score[y, x])[:_PER_RADIUS]
        return [
            (float(score[j, i]), i - margin + 0.5, j - margin + 0.5, radius)
            for i, j in zip(x[best], y[best], strict=True)
        ]

    def _votes(self, x: np.ndarray, y: np.ndarray, margin: int) -> np.ndarray:
        """(H + 2 margin, W + 2 margin): weights, put down both ways along a vector from each edge."""
        height, width = (side + 2 * margin for side in self.size)
        votes = np.zeros(height * width)
        for sign in (-1, 1):
            row = np.rint(self.rows + sign * y).astype(int) + margin
            column = np.rint(self.columns + sign * x).astype(int) + margin
            inside = (row >= 0) & (column >= 0) & (row < height) & (column < width)
            votes += np.bincount((row * width + column)[inside], self.weight[inside], height * width)
        return votes.reshape(height, width).astype(np.float32)
