"""What a photograph shows along rays across the rim of a circle, and where along each the outline may be."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from torchbrdf.photograph._candidates import Place
from torchbrdf.photograph._charts import Chart
from torchbrdf.photograph._pyramid import Pyramid

_SPACING = 0.5
"""Of samples along a ray, in pixels."""

_INSIDE, _OUTSIDE, _SOFT = 3.0, 6.0, 0.3
"""Pixels on either side of an outline that tell whether it is one, and how softly they end."""

_FLOOR = 0.004
"""Deviations that count as none, of the mean along the ray."""

_TEMPER = 0.1
"""Of the evidence: neighbouring samples and channels are not independent, and no model of them is exact."""

OUTLIERS = 0.1
"""Share of rays on which something else is taken for the outline."""

_FINE = 5
"""Steps between samples when what a lens shows is integrated."""


@dataclass(frozen=True)
class Rays:
    """Values (A, P, 3) on rays at some angles (A,) across a circle, distances (P,) from it in radii outwards.

    pixels  the circle's radius in pixels of the pyramid's level
    """

    angles: np.ndarray
    distances: np.ndarray
    values: np.ndarray
    pixels: float

    @classmethod
    def across(
        cls, pyramid: Pyramid, chart: Chart, place: Place, wanted: float, reach: float, n: int, floor: float | None
    ) -> Rays:
        """n rays, less those that leave what is usable.

        wanted  pixels of the radius at the pyramid's level, about
        reach   radii to either side
        floor   what is added to radiance before its logarithm; None for radiance itself
        """
        x, y, radius = place
        level = pyramid.level(radius, wanted)
        pixels = radius / 2**level
        half = int(np.ceil(reach * pixels / _SPACING))
        distances = np.arange(-half, half + 1) * (_SPACING / pixels)
        angles = 2 * np.pi * np.arange(n) / n
        outwards = np.stack([np.cos(angles), np.sin(angles)], -1)
        points = np.array([x, y]) + radius * (1 + distances[:, None]) * outwards[:, None]
        values = pyramid.sampled(chart.to_photograph(points), level)
        if floor is not None:
            values = np.log(np.maximum(values, 0) + floor)
        seen = np.isfinite(values).all((1, 2))
        return cls(angles[seen], distances, values[seen], pixels)

    def harmonics(self, order: int = 1) -> np.ndarray:
        """(A, 1 + 2 order): by how much the rim moves outwards with x, y and radius; of order 2, with an ellipse."""
        turns = [turn for k in range(1, order + 1) for turn in (np.cos(k * self.angles), np.sin(k * self.angles))]
        return np.stack([*turns[:2], np.ones_like(self.angles), *turns[2:]], -1)

    def votes(self, offsets: np.ndarray, blurs: tuple[float, ...]) -> Iterator[np.ndarray]:
        """(A, R) for each blur: log of how much likelier than anywhere an outline at each offset (R,) is, ray by ray.

        offsets  in radii
        blurs    standard deviations of what lens and pixels do, in pixels of the level
        At each offset, an outline is compared with a smooth change, in pixels close to it: with what a ball may show
        there. Inside, radiance is linear in the cosine to the normal, which falls like a square root towards the rim;
        outside it is linear.
        """
        a, p, c = self.values.shape
        scale = np.abs(self.values).mean(1) + 1e-30
        y = ((self.values - self.values.mean(1, keepdims=True)) / scale[:, None]).transpose(1, 0, 2).reshape(p, a * c)
        away = (self.distances - offsets[:, None]) * self.pixels
        soft = np.where(away < 0, -away - _INSIDE, away - _OUTSIDE) / _SOFT
        window = 1 / (1 + np.exp(np.clip(soft, -50, 50)))
        root = np.sqrt(window)[..., None]
        whole = window.astype(np.float32) @ y**2
        count = window.sum(1, keepdims=True)

        def left(functions: np.ndarray) -> np.ndarray:
            explained = ((_projector(root, functions) @ y) ** 2).sum(1)
            return np.asarray(np.maximum(whole - explained, 0) / count + _FLOOR**2)

        smooth = left((away / _OUTSIDE)[..., None] ** np.arange(4))
        for blur in blurs:
            edge = left(self._shown(offsets, blur / self.pixels))
            gain = (0.5 * _SPACING * _TEMPER) * count * np.log(smooth / edge)
            gain = gain.reshape(len(offsets), a, c).sum(2).T
            most = gain.max(1, keepdims=True).clip(min=0)
            likely = np.exp(gain - most)
            share = likely / (likely.mean(1, keepdims=True) + np.exp(-most))
            votes = np.log((1 - OUTLIERS) * share + OUTLIERS)
            yield np.ascontiguousarray(votes - votes.mean(1, keepdims=True), np.float64)

    def _shown(self, offsets: np.ndarray, blur: float) -> np.ndarray:
        """(R, P, 4): constant and cosine inside an outline at each offset, constant and slope outside, blurred."""
        fine, lens = through_lens(self.distances, blur)
        beyond = (1 + fine) / (1 + offsets[:, None]) - 1
        cosine = np.sqrt(np.maximum(1 - (1 + beyond) ** 2, 0))
        inside = beyond < 0
        return lens @ np.stack([inside, cosine, ~inside, np.maximum(beyond, 0) * self.pixels], -1)


def through_lens(distances: np.ndarray, blur: float) -> tuple[np.ndarray, np.ndarray]:
    """Finer distances (F,) than some (P,), and the shares (P, F) that a lens takes of what is at each of them.

    blur  standard deviation, in the unit of the distances
    """
    step = (distances[1] - distances[0]) / _FINE
    fine = np.arange(distances[0] - 4 * blur, distances[-1] + 4 * blur + step, step)
    lens = np.exp(-0.5 * ((distances[:, None] - fine) / blur) ** 2)
    lens /= lens.sum(1, keepdims=True)
    return fine, lens


def _projector(root: np.ndarray, functions: np.ndarray) -> np.ndarray:
    """(R, k, P) float32: coefficients of weighted values in an orthonormal basis of weighted functions (R, P, k)."""
    basis = np.linalg.qr(root * functions)[0] * root
    return np.ascontiguousarray(basis.transpose(0, 2, 1), np.float32)
