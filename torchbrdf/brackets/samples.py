"""Places of a bracket where the scene is smooth, so that frames can be compared without being resampled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchbrdf.brackets.frames import Frame
from torchbrdf.brackets.registration import Motion

_HALF = 2
"""Patches are 5 x 5 pixels."""
_CANDIDATES = 60_000
_TAKEN = 4000
_LEVELS = 40
"""Of brightness, from each of which as many patches are taken."""
_DARKEST_STEPS = 1.0
_BRIGHT = 0.5


@dataclass(frozen=True)
class Samples:
    """Mean codes of patches in all frames.

    codes       (F, N, 3)  in [0, 1], of the smoothest; NaN where a frame clips or cuts any pixel of a patch
    everywhere  (F, R, C, 3)  of a grid of patches, whatever they show
    """

    codes: np.ndarray
    everywhere: np.ndarray

    @classmethod
    def of(cls, frames: Sequence[Frame], motions: Sequence[Motion], clip: np.ndarray) -> Samples:
        """Patches on a grid over the frames, the smoothest of every brightness.

        motions  from the reference to each frame
        clip     (3,)  from which value on codes are clipped
        """
        size = frames[0].codes.shape[:2]
        step = max(1, int(np.sqrt(size[0] * size[1] / _CANDIDATES)))
        grid = np.mgrid[_HALF : size[0] - _HALF : step, _HALF : size[1] - _HALF : step]
        rows, columns = (axis.ravel() for axis in grid)
        means, spreads = [], []
        for frame, motion in zip(frames, motions, strict=True):
            mean, spread = _patches(frame, motion, rows, columns, clip)
            means.append(mean)
            spreads.append(spread)
        codes = np.stack(means)
        held = np.isfinite(codes).all(axis=2).sum(axis=0)
        rough = np.nanmax(np.where(np.isfinite(codes), np.stack(spreads), np.nan), axis=(0, 2), initial=0)
        useful = np.flatnonzero(held >= 2)
        return cls(codes[:, useful[_smoothest(codes[:, useful], rough[useful])]], codes.reshape(-1, *grid.shape[1:], 3))

    @property
    def count(self) -> int:
        """How many patches."""
        return int(self.codes.shape[1])


def _patches(
    frame: Frame, motion: Motion, rows: np.ndarray, columns: np.ndarray, clip: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) means, NaN where a patch is not held whole, and relative spreads."""
    size = (frame.codes.shape[0], frame.codes.shape[1])
    m = motion.matrix(size)
    x, y = (np.rint(row[0] * columns + row[1] * rows + row[2]).astype(int) for row in m)
    inside = (x >= _HALF) & (x < size[1] - _HALF) & (y >= _HALF) & (y < size[0] - _HALF)
    x, y = np.where(inside, x, _HALF), np.where(inside, y, _HALF)
    total = np.zeros((len(rows), 3))
    squares = total.copy()
    pixels, middle = frame.codes.reshape(-1, 3), y * size[1] + x
    low = high = pixels.take(middle, axis=0)
    for dy in range(-_HALF, _HALF + 1):
        for dx in range(-_HALF, _HALF + 1):
            codes = pixels.take(middle + (dy * size[1] + dx), axis=0)
            values = codes / frame.full_scale
            total += values
            squares += np.square(values, out=values)
            low, high = np.minimum(low, codes), np.maximum(high, codes)
    low, high = low / frame.full_scale, high / frame.full_scale
    count = (2 * _HALF + 1) ** 2
    mean = total / count
    spread = np.sqrt(np.maximum(squares / count - mean**2, 0)) / np.maximum(mean, 1e-9)
    held = inside & (low > _DARKEST_STEPS * frame.step).all(axis=1) & (high < clip).all(axis=1)
    return np.where(held[:, None], mean, np.nan), spread


def _smoothest(codes: np.ndarray, rough: np.ndarray) -> np.ndarray:
    """Of patches (F, N, 3), those of each brightness that vary least."""
    brightness = np.zeros(codes.shape[1])
    for one in codes.mean(axis=2):  # ranks need no response; what a frame does not hold is bright, or dark for it
        held = np.isfinite(one)
        beyond = np.inf if held.any() and one[held].max() > _BRIGHT else -np.inf
        brightness += np.argsort(np.argsort(np.where(held, one, beyond)))
    cuts = np.quantile(brightness, np.linspace(0, 1, _LEVELS + 1)[1:-1]) if len(brightness) else np.empty(0)
    level = np.searchsorted(cuts, brightness)
    taken = []
    for one in range(_LEVELS):
        members = np.flatnonzero(level == one)
        taken.append(members[np.argsort(rough[members], kind="stable")[: _TAKEN // _LEVELS]])
    return np.concatenate(taken)
