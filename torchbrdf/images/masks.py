"""Masks from files: which pixels show the shape, however the file marks them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchbrdf.images.formats import read_stored

_OPAQUE = 0.5
_MOST_LABELS = 16
_GREY = (0.1, 0.9)
"""Of the brightest: what lies between is neither black nor white."""
_MUCH_GREY = 0.3
_FEW_WHITE = 0.3
"""Of all that is not black; shapes with soft edges have more, photographs less."""
_SAME_WHITE = 0.03
_LITTLE_GREY = 0.05
_OTHER_COLOUR = 0.25
_MUCH_OF_ANOTHER = 0.02


@dataclass(frozen=True)
class Mask:
    """Which pixels are marked, and by what.

    marked  (1, H, W) bool
    about   how the file was read where it could be read otherwise; empty for white on black
    """

    marked: Tensor
    about: str = ""


def read_mask(path: str | os.PathLike[str], layer: str | None = None) -> Tensor:
    """Read a mask: True (use this pixel) where the shape is marked; see `open_mask`. Returns (1, H, W) bool."""
    return open_mask(path, layer).marked


def open_mask(path: str | os.PathLike[str], layer: str | None = None) -> Mask:
    """Read a mask, and say how it marks the shape.

    path       of any format of `read_image`. The shape is what is brighter than half of the brightest: white, 1 among
               labels 0 and 1, or one colour on black. Where alpha differs between pixels it is the mask, unless the
               colours under it are black and white themselves
    raises     FileNotFoundError; ValueError when the file is not such an image, or marks several things
    """
    path = Path(path)
    stored = read_stored(path, layer)
    colours = np.nan_to_num(stored.values, nan=0.0, posinf=np.inf, neginf=0.0).clip(0)
    bright = colours.max(axis=0)
    peak, least = float(bright.max()), float(bright.min())
    if not np.isfinite(peak):
        raise ValueError(f"{path}: holds infinite values; a mask is white on black")
    two = ((bright == peak) | (bright == least)).all()
    marked = bright == peak if two and least < peak else bright > peak / 2
    if (alpha := stored.telling_alpha) is not None:
        opaque = alpha > _OPAQUE
        if _painted(bright[opaque], marked[opaque], peak):
            return Mask(torch.from_numpy((opaque & marked)[None]), "white where it is opaque")
        return Mask(torch.from_numpy(opaque[None]), "its alpha")
    if not two:
        _check_levels(path, bright * (stored.full_scale or 1))
        _check_few_greys(path, bright, marked, _GREY[0] * peak if stored.full_scale else least)
    _check_one_colour(path, colours, marked)
    label = stored.full_scale > 0 and 0 < peak <= 0.5
    return Mask(torch.from_numpy(marked[None]), f"label {round(peak * stored.full_scale)}" if label else "")


def _grey(values: np.ndarray, peak: float) -> np.ndarray:
    """Which values lie between black and white."""
    low, high = _GREY
    return (values > low * peak) & (values < high * peak)


def _painted(values: np.ndarray, marked: np.ndarray, peak: float) -> bool:
    """Whether values are white, where marked, on black themselves, and not those of a photograph."""
    share = float(marked.mean()) if marked.size else 0.0
    return _LITTLE_GREY < share < 1 - _LITTLE_GREY and float(_grey(values, peak).mean()) < _LITTLE_GREY


def _check_levels(path: Path, levels: np.ndarray) -> None:
    """Raise where a few numbers name several things: small ones, or areas between the darkest and the brightest.

    The edges of a smoothed shape have numbers between, but no areas.
    """
    found = np.unique(levels[:: max(1, len(levels) // 64)])
    if len(found) > _MOST_LABELS or len(found := np.unique(levels)) > _MOST_LABELS:
        return
    inner = levels[1:-1, 1:-1]
    rows, columns = levels.shape
    same = np.ones(inner.shape, dtype=bool)
    for row, column in np.ndindex(3, 3):
        same &= levels[row : rows - 2 + row, column : columns - 2 + column] == inner
    areas = set(np.unique(inner[same]).tolist()) - {found[0], found[-1]}
    if areas or (found[-1] <= _MOST_LABELS and (found == found.round()).all()):
        which = ", ".join(f"{level:g}" for level in found)
        raise ValueError(f"{path}: marks several things ({which}); write 1 where the shape is, 0 elsewhere")


def _check_few_greys(path: Path, bright: np.ndarray, marked: np.ndarray, black: float) -> None:
    """Raise where values are those of a photograph.

    black  above which values are not black: where numbers are exact, the least of them
    """
    level = float(np.median(bright[marked]))  # JPEG makes edges brighter than the shape
    white = np.abs(bright - level) <= _SAME_WHITE * level
    if _grey(bright, level).mean() > _MUCH_GREY or white.sum() < _FEW_WHITE * (bright > black).sum():
        raise ValueError(f"{path}: is no mask, many pixels are neither black nor white; paint the shape white on black")


def _check_one_colour(path: Path, colours: np.ndarray, marked: np.ndarray) -> None:
    """Raise where what is marked has several colours."""
    if len(colours) == 1 or not marked.any():
        return
    hues = colours[:, marked] / colours[:, marked].max(axis=0)
    other = np.abs(hues - np.median(hues, axis=1, keepdims=True)).max(axis=0) > _OTHER_COLOUR
    if other.mean() > _MUCH_OF_ANOTHER:
        raise ValueError(f"{path}: has several colours; paint the shape in one of them on black")
