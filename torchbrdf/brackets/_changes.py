"""What changed between exposures: of things that moved, or took another's place, a merged picture shows a mixture."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from torchbrdf.arguments import warn
from torchbrdf.brackets._choice import Chosen
from torchbrdf.brackets.frames import Frame
from torchbrdf.brackets.samples import Samples

_RATIO = 1.3
"""Of the radiance that two exposures show at a place, from which on it is not the same."""
_SHARE, _MOST = 1e-3, 0.25
"""Of all places: with more than the first, a warning; more than the second is no part of a scene but another response,
time or light, which other warnings are of."""
_AROUND = 5
"""Places along a side of a square that has to differ throughout: of a hand that moved a little, edges differ alone."""
_DARKEST_STEPS = 10.0
"""Codes that are darker tell radiance too coarsely."""


def warn_of_changes(frames: Sequence[Frame], samples: Samples, chosen: Chosen) -> None:
    """Warn where two exposures, each and the next longer one, do not show the same in some part of the picture."""
    codes = samples.everywhere
    steps = np.array([frame.step for frame in frames])[:, None, None, None]
    told = np.isfinite(codes) & (codes > _DARKEST_STEPS * steps)
    radiance = np.where(told, chosen.curve.decode_all(codes), np.nan).sum(axis=-1) / chosen.exposures[:, None, None]
    shares = [_changed(*pair) for pair in pairwise(radiance)]
    worst = int(np.argmax(shares))
    if _SHARE < shares[worst] < _MOST:
        warn(
            f"{frames[worst + 1].path} and {frames[worst].path}: {shares[worst]:.1%} of the picture differs by more "
            f"than {_RATIO - 1:.0%}: something moved, or they are not of one scene; a mixture is shown there"
        )


def _changed(one: np.ndarray, other: np.ndarray) -> float:
    """The share of the places in squares in which radiance (R, C) differs; NaN where one does not tell it."""
    import cv2

    with np.errstate(divide="ignore", invalid="ignore"):
        apart = np.abs(np.log(one / other)) > np.log(_RATIO)  # False where one of them is NaN
    square = np.ones((_AROUND, _AROUND), np.uint8)
    return float(cv2.morphologyEx(apart.astype(np.uint8), cv2.MORPH_OPEN, square).mean())
