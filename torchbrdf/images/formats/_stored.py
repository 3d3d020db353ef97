"""What a file of a picture holds, before it is taken for a photograph, a mask or anything else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torchbrdf.images.encodings import Transfer
from torchbrdf.images.primaries import Primaries

MAX_PIXELS = 2**28
"""A header may ask for any size; 2**28 RGB pixels are 3 GB."""

_MAX_STRETCH = 1e-3

_ROUNDING = 1e-3
"""Relative differences of alpha below this tell nothing: renderers add it up, sample by sample."""


class Window(NamedTuple):
    """A rectangle of pixels of a picture."""

    left: int
    top: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Its rows and columns."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)


class Colours(NamedTuple):
    """What a file says of its colours: how values are decoded, and their space; None where it does not say."""

    transfer: Transfer | None = None
    primaries: Primaries | None = None


@dataclass(frozen=True)
class Stored:
    """What a file holds.

    values      (C, H, W) float32, rows from the top: C = 3 for R, G, B, 1 for grey; integers over their full scale
    kind        what messages call the file, such as "8-bit PNG"
    alpha       (H, W) float32 in [0, 1]; None where there is none
    full_scale  of integers; 0 where the values are floating-point, and linear
    colours     gives what the file says of its colours; raises ValueError where that is not understood. Masks and
                vectors do not ask
    window      the part of the picture that was recorded; None for all of it. The values beside it are NaN
    about       what was chosen among what the file holds, for people; empty where there was no choice
    """

    values: np.ndarray
    kind: str
    alpha: np.ndarray | None = None
    full_scale: int = 0
    colours: Callable[[], Colours] = Colours
    window: Window | None = None
    about: str = ""

    @property
    def telling_alpha(self) -> np.ndarray | None:
        """Alpha, where it tells one recorded pixel from another."""
        if self.alpha is None:
            return None
        recorded = self.alpha if self.window is None else self.alpha[self.window.slices]
        low, high = float(recorded.min()), float(recorded.max())
        return None if high - low <= _ROUNDING * max(abs(low), abs(high)) else self.alpha

    def turned(self, orientation: int) -> Stored:
        """Upright, by the EXIF orientation 1 to 8 in which it is stored; others count as 1."""
        alpha = None if self.alpha is None else _upright(self.alpha, orientation)
        return replace(self, values=_upright(self.values, orientation), alpha=alpha)


def _upright(values: np.ndarray, orientation: int) -> np.ndarray:
    """Values (..., H, W) whose first row is the top, right, bottom or left of the picture [TIFF6, section 8]."""
    if orientation in (5, 6, 7, 8):
        values = values.swapaxes(-1, -2)
    if orientation in (3, 4, 7, 8):
        values = values[..., ::-1, :]
    if orientation in (2, 3, 6, 7):
        values = values[..., ::-1]
    return values.copy()  # an axis of one pixel keeps a negative stride else, which torch does not take


def check_pixel_aspect(path: Path, ratio: float) -> None:
    """Raise ValueError where pixels are not square."""
    if not abs(ratio - 1) <= _MAX_STRETCH:
        raise ValueError(
            f"{path}: pixels are not square (pixel aspect ratio {ratio:g}): a ball would be an ellipse; "
            "resample the picture to square pixels"
        )


def unreadable(path: Path, kind: str, reason: str = "truncated, damaged or another format") -> ValueError:
    """The error of a file that is not what its suffix says."""
    return ValueError(f"{path}: not a readable {kind} image ({reason})")
