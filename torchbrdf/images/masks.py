"""Masks from files: which pixels show the shape, however the file marks them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchbrdf.images.formats import Stored, read_stored

_OPAQUE = 0.5
_MOST_LABELS = 16
_GREY = (0.1, 0.9)
"""Of the brightest: what lies between is neither black nor white."""
_MUCH_GREY = 0.3
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
    peak = float(bright.max())
    if not np.isfinite(peak):
        raise ValueError(f"{path}: holds infinite values; a mask is white on black")
    if len(np.unique(bright)) == 2:  # the brighter is the mask, however dim
        bright = np.where(bright == peak, np.float32(peak), np.float32(0))
    alpha = _alpha(stored)
    if alpha is not None:
        opaque = alpha > _OPAQUE
        white = opaque & (bright > peak / 2)
        if _painted(bright[opaque], peak):
            return Mask(torch.from_numpy(white[None]), "white where it is opaque")
        return Mask(torch.from_numpy(opaque[None]), "its alpha")
    if peak == 0:
        return Mask(torch.zeros(1, *bright.shape, dtype=torch.bool))
    _check_labels(path, stored, bright)
    marked = bright > peak / 2
    _check_one_colour(path, colours, marked)
    if _grey_share(bright, peak) > _MUCH_GREY:
        raise ValueError(f"{path}: is no mask, many pixels are neither black nor white; paint the shape white on black")
    about = "" if stored.full_scale == 0 or peak > 0.5 else f"label {round(peak * stored.full_scale)}"
    return Mask(torch.from_numpy(marked[None]), about)


def _alpha(stored: Stored) -> np.ndarray | None:
    """Alpha, where it tells one pixel from another."""
    return None if stored.alpha is None or stored.alpha.min() == stored.alpha.max() else stored.alpha


def _grey_share(values: np.ndarray, peak: float) -> float:
    """How many values lie between black and white."""
    low, high = _GREY
    return float(((values > low * peak) & (values < high * peak)).mean())


def _painted(values: np.ndarray, peak: float) -> bool:
    """Whether values are white on black themselves, and not those of a photograph."""
    if not values.size or not peak:
        return False
    share = float((values > peak / 2).mean())
    return _LITTLE_GREY < share < 1 - _LITTLE_GREY and _grey_share(values, peak) < _LITTLE_GREY


def _check_labels(path: Path, stored: Stored, bright: np.ndarray) -> None:
    """Raise where small integers name several things."""
    if not stored.full_scale or bright.max() * stored.full_scale > _MOST_LABELS:
        return
    labels = np.unique(np.rint(bright * stored.full_scale).astype(int)).tolist()
    if len(labels) > 2:
        raise ValueError(f"{path}: holds labels {', '.join(map(str, labels))}; write 1 where the shape is, 0 elsewhere")


def _check_one_colour(path: Path, colours: np.ndarray, marked: np.ndarray) -> None:
    """Raise where what is marked has several colours."""
    if len(colours) == 1 or not marked.any():
        return
    hues = colours[:, marked] / colours[:, marked].max(axis=0)
    other = np.abs(hues - np.median(hues, axis=1, keepdims=True)).max(axis=0) > _OTHER_COLOUR
    if other.mean() > _MUCH_OF_ANOTHER:
        raise ValueError(f"{path}: has several colours; paint the shape in one of them on black")
