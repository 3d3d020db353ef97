"""The circle that all rays across a rim agree on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from torchbrdf.photograph._candidates import Place
from torchbrdf.photograph._charts import Chart
from torchbrdf.photograph._pyramid import Pyramid
from torchbrdf.photograph._rim import Rays

_LEAST_RADIUS = 3.0
"""Pixels up to which nothing is a ball."""

BESIDE = 6.0
"""Pixels that are looked at beyond the farthest outline."""

_OFFSETS = 57
_GRID = 9
_SOONER = 4
"""Every so many rays are enough for a first guess."""

_LEAST_SEEN = 0.3
"""Share of the rays that must lie in the photograph."""

_BLOCKS = 24
"""Arcs whose evidence is taken as independent."""

_VOTE = 0.7
"""From here on a ray speaks for the outline."""

_TOO_SURE, LEAST_STD = 2.0, 0.15
"""By what factor arcs agree better than they are right, and pixels of the level by which all are wrong together."""


@dataclass(frozen=True)
class Ellipse:
    """A circle in a chart, moved, and stretched along one direction.

    shift      (5,)  of the rim, as `Rays.harmonics` of order 2, in radii of the circle before
    amplitude  by how much it leaves a circle, in radii
    std        of the amplitude
    """

    before: Place
    shift: np.ndarray
    amplitude: float
    std: float

    def points(self, n: int) -> np.ndarray:
        """(n, 2) of the chart."""
        x, y, radius = self.before
        turn = 2 * np.pi * np.arange(n) / n
        outwards = np.stack([np.cos(turn), np.sin(turn)], -1)
        by = np.stack([np.cos(turn), np.sin(turn), np.ones(n), np.cos(2 * turn), np.sin(2 * turn)], -1) @ self.shift
        return np.array([x, y]) + radius * (1 + by[:, None]) * outwards


@dataclass(frozen=True)
class Outline:
    """A circle in a chart, and the rays that it was found on.

    votes    (A, R) of the rays at offsets (R,) from the circle before, in radii
    shift    how the circle moved from there: x, y and radius, in radii
    n        rays all around, whether seen or not
    doubt    by how much models disagree on x, y or radius, in radii
    """

    before: Place
    rays: Rays
    offsets: np.ndarray
    votes: np.ndarray
    shift: np.ndarray
    n: int
    doubt: float = 0.0

    @classmethod
    def near(
        cls,
        pyramid: Pyramid,
        chart: Chart,
        place: Place,
        *,
        wanted: float,
        reach: float,
        n: int,
        blurs: tuple[float, ...] = (1.0,),
        floor: float | None = None,
    ) -> Outline | None:
        """The best within `reach` radii of a place; see `Rays.across`. None where too little of it is in the frame.

        blurs  to choose the likeliest from, in pixels
        """
        if place[2] <= _LEAST_RADIUS:
            return None
        margin = BESIDE / min(place[2], wanted)
        rays = Rays.across(pyramid, chart, place, wanted, reach + margin, n, floor)
        if len(rays.angles) < _LEAST_SEEN * n:
            return None
        offsets = np.linspace(-reach, reach, _OFFSETS)
        best: tuple[float, np.ndarray, np.ndarray] | None = None
        start: np.ndarray | None = None
        basis = rays.harmonics()
        for votes in rays.votes(offsets, blurs):
            if start is None:
                start = guess(votes[::_SOONER], basis[::_SOONER], offsets)
            shift, score = climb(votes, basis, offsets, start)
            if best is None or score > best[0]:
                best = score, shift, votes
        assert best is not None  # there is a blur
        return cls(place, rays, offsets, best[2], best[1], n)

    @property
    def place(self) -> Place:
        """The circle."""
        (x, y, radius), (right, down, larger) = self.before, self.shift.tolist()
        return x + radius * right, y + radius * down, radius * (1 + larger)

    @cached_property
    def here(self) -> np.ndarray:
        """(A,): the votes of the rays for the circle."""
        return along(self.votes, self.rays.harmonics() @ self.shift, self.offsets)

    @property
    def score(self) -> float:
        """Mean of the votes all around."""
        return float(self.here.sum() / self.n)

    @property
    def seen(self) -> float:
        """Share of the rim whose rays lie in the photograph."""
        return len(self.here) / self.n

    @property
    def share(self) -> float:
        """Share of the rim that is seen as an outline."""
        return float((self.here > _VOTE).sum() / self.n)

    @cached_property
    def std(self) -> np.ndarray:
        """(3,): standard deviations of x, y and radius, in radii: arcs of the rim disagree, and all are a bit wrong."""
        disagreement = np.diag(self._covariance(self.rays.harmonics(), self.shift))
        return np.asarray(np.sqrt(_TOO_SURE**2 * disagreement + (LEAST_STD / self.rays.pixels) ** 2))

    @cached_property
    def ellipse(self) -> Ellipse:
        """The outline as an ellipse."""
        basis = self.rays.harmonics(2)
        shift, _ = climb(self.votes, basis, self.offsets, np.append(self.shift, [0, 0]))
        spread = float(np.trace(self._covariance(basis, shift)[3:, 3:]) / 2)
        std = float(np.sqrt(_TOO_SURE**2 * spread + (LEAST_STD / self.rays.pixels) ** 2))
        return Ellipse(self.before, shift, float(np.hypot(*shift[3:])), std)

    def _covariance(self, basis: np.ndarray, shift: np.ndarray) -> np.ndarray:
        """Of an M-estimate: H^-1 G H^-1, with the curvature H of the votes and the spread G of slopes among arcs."""
        step = 2 * (self.offsets[1] - self.offsets[0])
        low, middle, high = (along(self.votes, basis @ shift + d, self.offsets) for d in (-step, 0, step))
        slope, bend = (high - low) / (2 * step), (2 * middle - low - high) / step**2
        block = (self.rays.angles / (2 * np.pi) * _BLOCKS).astype(int)
        sums = np.stack([np.bincount(block, slope * column, _BLOCKS) for column in basis.T], -1)
        curvature = basis.T @ (np.maximum(bend, 0)[:, None] * basis)
        values, vectors = np.linalg.eigh(curvature)
        inverse = (vectors / np.maximum(values, 1e-6 * abs(values).max() + 1e-12)) @ vectors.T
        return np.asarray(inverse @ (sums.T @ sums) @ inverse)


def along(votes: np.ndarray, offset: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """(..., A): votes (A, R) at an offset (..., A) for each ray, linear between those given; the last beyond them."""
    at = (offset - offsets[0]) / (offsets[1] - offsets[0])
    at = np.minimum(np.maximum(at, 0), len(offsets) - 1.001)  # `clip` and indices along two axes take twice as long
    low = at.astype(np.intp)
    part = at - low
    here, flat = low + np.arange(0, votes.size, len(offsets)), votes.ravel()
    return np.asarray(flat.take(here) * (1 - part) + flat.take(here + 1) * part)


def climb(votes: np.ndarray, basis: np.ndarray, offsets: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, float]:
    """The shift (k,) near another for which the rays' votes sum to most, and that sum; basis (A, k).

    Pattern search along directions that are independent on the rays that are seen.
    """
    _, r = np.linalg.qr(basis)
    directions = np.linalg.inv(r) * np.sqrt(len(basis))
    moves = np.concatenate([directions.T, -directions.T])
    step = offsets[1] - offsets[0]
    size, best = 4 * step, float(along(votes, basis @ shift, offsets).sum())
    while size > 0.02 * step:
        trials = shift + size * moves
        sums = along(votes, trials @ basis.T, offsets).sum(-1)
        top = int(sums.argmax())
        if sums[top] > best + 1e-9:
            shift, best = trials[top], float(sums[top])
        else:
            size /= 2
    return shift, best


def guess(votes: np.ndarray, basis: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """The best shift of a grid."""
    middle = np.linspace(-0.7, 0.7, _GRID) * offsets[-1]
    grid = np.stack(np.meshgrid(middle, middle, offsets[::2], indexing="ij"), -1).reshape(-1, 3)
    grid = grid[np.hypot(grid[:, 0], grid[:, 1]) + np.abs(grid[:, 2]) <= 1.1 * offsets[-1]]
    sums = along(votes, grid @ basis.T, offsets).sum(-1)
    return np.asarray(grid[sums.argmax()])
