"""How the camera moved between two exposures: a shift and a turn, to a fraction of a pixel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import cos, hypot, sin

import numpy as np

_COARSEST = 160
"""Pixels along the longer side at which any shift is looked for."""
_LARGEST = 3200
"""Of larger frames, means of 2 x 2 pixels tell as much."""
_OVERLAP = 0.4
_POINTS = 60_000
_FEWEST_POINTS = 300
_BLOCKS = 8
_ITERATIONS = 12
_CONVERGED = 2e-3
_DARKEST, _BRIGHTEST = 4 / 255, 0.96
"""Codes between which both frames show what moved."""
_SHOWN = 0.5
_QUANTILES = 512
_DIFFERENT, _ALIKE = 0.6, 0.95
"""Correlations of two frames that show something else, and the same."""
_BOTH = 0.01
"""Share of the pixels that both must show."""
_NEARLY_STILL = 0.1


@dataclass(frozen=True)
class Motion:
    """Where a frame shows what the reference shows at (x, y): turned about the middle, then shifted, in pixels."""

    x: float = 0.0
    y: float = 0.0
    turn_rad: float = 0.0

    def matrix(self, size: tuple[int, int]) -> np.ndarray:
        """(2, 3): from places of the reference to places of the frame, pixels' centres at whole numbers."""
        x, y = (size[1] - 1) / 2, (size[0] - 1) / 2
        c, s = cos(self.turn_rad), sin(self.turn_rad)
        return np.array([[c, -s, x - c * x + s * y + self.x], [s, c, y - s * x - c * y + self.y]])

    def after(self, first: Motion) -> Motion:
        """The motion by `first` and then by this."""
        c, s = cos(self.turn_rad), sin(self.turn_rad)
        x, y = c * first.x - s * first.y + self.x, s * first.x + c * first.y + self.y
        return Motion(x, y, self.turn_rad + first.turn_rad)

    def scaled(self, factor: float) -> Motion:
        """The motion in pixels of another size."""
        return Motion(self.x * factor, self.y * factor, self.turn_rad)

    def inverse(self) -> Motion:
        """The motion back."""
        c, s = cos(self.turn_rad), sin(self.turn_rad)
        return Motion(-c * self.x - s * self.y, s * self.x - c * self.y, -self.turn_rad)

    def pixels(self, size: tuple[int, int]) -> float:
        """How far the corners move at most."""
        return hypot(self.x, self.y) + abs(self.turn_rad) * hypot(*size) / 2

    def still(self, size: tuple[int, int]) -> bool:
        """Whether it is less than registration tells, so that pixels are better left as they are."""
        return self.pixels(size) < _NEARLY_STILL


def find_motion(dark: np.ndarray, bright: np.ndarray) -> Motion | None:
    """From a frame to one of longer exposure, both (H, W) float32 codes in [0, 1] with clipping at 1.

    The tones of one are matched to those of the other by their distributions, which needs no response [GN03]; then
    places are found by least squares from coarse to fine [LK81].
    None where they have too little in common to tell. Raises LookupError where they do not match.
    """
    width = bright.shape[1]
    while max(bright.shape) > _LARGEST:
        bright, dark = (_halved(one, (one.shape[1] // 2, one.shape[0] // 2)) for one in (bright, dark))
    levels = list(_pyramid(bright, dark))
    if min(np.isfinite(one).mean() for one in levels[0]) < _BOTH:
        return None
    motion = _coarse(*levels[-1]).scaled(width / levels[-1][0].shape[1])
    for a, b in reversed(levels):
        scale = a.shape[1] / width
        refined = _refined(a, b, motion.scaled(scale))
        if refined is None:
            return None
        motion = refined.scaled(1 / scale)
    middle = next((level for level in levels if max(level[0].shape) <= 4 * _COARSEST), levels[-1])
    alike = _correlation(*middle, motion.scaled(middle[0].shape[1] / width))
    if alike < _DIFFERENT:
        raise LookupError
    return motion.inverse() if alike > _ALIKE or motion.still(bright.shape) else None  # chance ends nowhere near none


def _pyramid(a: np.ndarray, b: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Both from fine to coarse; NaN where one shows nothing."""
    a, b = (_shown(one) for one in _matched(a, b))
    yield a, b
    while max(a.shape) > _COARSEST and min(a.shape) >= 8:
        half = (a.shape[1] // 2, a.shape[0] // 2)
        a, b = (_halved(one, half) for one in (a, b))
        yield a, b


def _halved(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Means over what is shown; NaN where that is less than half."""
    import cv2

    shown = np.isfinite(image)
    total, share = (
        cv2.resize(one.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        for one in (np.where(shown, image, 0), shown)
    )
    return np.where(share >= _SHOWN, total / np.maximum(share, _SHOWN), np.nan).astype(np.float32)


def _shown(codes: np.ndarray) -> np.ndarray:
    return np.where((codes > _DARKEST) & (codes < _BRIGHTEST), codes, np.nan).astype(np.float32)


def _matched(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The tones of `a` as those of `b`, by quantiles; values of one code are spread over its width."""
    random = np.random.default_rng(0)
    step = max(1, a.size // 200_000)
    levels = np.linspace(0, 1, _QUANTILES)
    spread = [
        one.ravel()[::step] + random.uniform(-0.5, 0.5, one[..., None].ravel()[::step].shape) / 255 for one in (a, b)
    ]
    qa, qb = (np.nanquantile(one, levels) for one in spread)
    mapped = np.interp(a.ravel(), qa, qb).reshape(a.shape).astype(np.float32)
    return np.where((a > _DARKEST) & (a < _BRIGHTEST), mapped, np.nan), b


def _coarse(a: np.ndarray, b: np.ndarray) -> Motion:
    """The shift, in whole pixels, at which correlation over what both show is greatest [Pad12]."""
    from skimage.registration import phase_cross_correlation

    shown = [np.isfinite(one) for one in (a, b)]
    filled = [np.where(valid, one, 0) for one, valid in zip((a, b), shown, strict=True)]
    shift, *_ = phase_cross_correlation(
        filled[0], filled[1], reference_mask=shown[0], moving_mask=shown[1], overlap_ratio=_OVERLAP
    )
    return Motion(-float(shift[1]), -float(shift[0]))


def _refined(a: np.ndarray, b: np.ndarray, motion: Motion) -> Motion | None:
    """Gauss-Newton on the places of pixels with steep tones; None where there are too few."""
    import cv2

    gy, gx = np.gradient(a)
    steep = np.where(np.isfinite(gx) & np.isfinite(gy), gx**2 + gy**2, -1.0)
    rows, columns = _spread(steep)
    if len(rows) < _FEWEST_POINTS:
        return motion if min(a.shape) <= _COARSEST // 2 else None
    x, y = columns - (a.shape[1] - 1) / 2, rows - (a.shape[0] - 1) / 2
    dx, dy, values = gx[rows, columns], gy[rows, columns], a[rows, columns]
    for _ in range(_ITERATIONS):
        m = motion.matrix(a.shape)
        at_x, at_y = (row[0] * columns + row[1] * rows + row[2] for row in m)
        shown = _sampled(cv2, b, at_x, at_y)
        residual = shown - values
        good = np.isfinite(residual)
        if good.sum() < _FEWEST_POINTS // 2:
            return None
        spread = 1.5 * np.median(np.abs(residual[good])) + 1e-4
        weight = good / np.maximum(1, np.abs(np.where(good, residual, 0)) / spread)
        jacobian = np.stack([dx, dy, dy * x - dx * y], axis=1)
        normal = (jacobian * weight[:, None]).T @ jacobian
        normal[2, 2] += 1e-9
        step = np.linalg.lstsq(normal, (jacobian * weight[:, None]).T @ np.where(good, residual, 0), rcond=1e-9)[0]
        motion = Motion(
            *(float(old - new) for old, new in zip((motion.x, motion.y, motion.turn_rad), step, strict=True))
        )
        if np.abs(step[:2]).max() + abs(step[2]) * max(a.shape) < _CONVERGED:
            break
    return motion


def _sampled(cv2: object, image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Values at places, by cubic interpolation; NaN beside the image and near what it does not show."""
    count = len(x)
    width = 256
    padded = [
        np.pad(one.astype(np.float32), (0, -count % width), constant_values=-100).reshape(-1, width) for one in (x, y)
    ]
    sampled = cv2.remap(image, *padded, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT, borderValue=float("nan"))  # type: ignore[attr-defined]
    found: np.ndarray = sampled.ravel()[:count]
    return found


def _spread(steep: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the steepest pixels of each block."""
    height, width = steep.shape
    each = max(8, _POINTS // _BLOCKS**2)
    rows, columns = [], []
    for top, bottom in _edges(height):
        for left, right in _edges(width):
            block = steep[top:bottom, left:right].ravel()
            best = np.argpartition(-block, min(each, len(block) - 1))[:each]
            best = best[block[best] > 0]
            rows.append(top + best // (right - left))
            columns.append(left + best % (right - left))
    return np.concatenate(rows), np.concatenate(columns)


def _edges(extent: int) -> Iterator[tuple[int, int]]:
    return pairwise(np.linspace(0, extent, min(_BLOCKS, extent) + 1).astype(int).tolist())


def _correlation(a: np.ndarray, b: np.ndarray, motion: Motion) -> float:
    """Of what both show; 1 where that is nothing or flat."""
    import cv2

    size = (a.shape[1], a.shape[0])
    moved = cv2.warpAffine(
        b,
        motion.matrix(a.shape),
        size,
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderValue=float("nan"),
    )
    both = np.isfinite(a) & np.isfinite(moved)
    if both.sum() < 30:
        return 0.0
    one, other = a[both], moved[both]
    return float(np.corrcoef(one, other)[0, 1]) if one.std() > 0 and other.std() > 0 else 1.0
