"""Whether a crop shows that a ball fills it."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from torchbrdf.photograph._pyramid import Pyramid
from torchbrdf.photograph.silhouette import Circle

_BESIDE = 1.02
"""Radii from which on a pixel lies beyond the rim."""

_DARK = 0.02
"""Of the median radiance inside: what lies beyond and is darker is cut away."""

_REACH, _STEP, _NEAR, _ANGLES = 0.15, 0.01, 0.02, 31
"""Radii on either side in which steps are compared, their length, and how near the rim is one of it."""

_WIDEST = 11.0
"""Degrees from a diagonal within which rays stay in the crop."""

_STEEP = 2.0
"""How many times the usual step of radiance that at the rim is."""


def fills(image: Tensor, usable: Tensor | None, circle: Circle) -> bool:
    """Whether what lies between an inscribed circle and the corners is cut away, or a rim is seen there.

    image   (3, H, W)
    usable  (1, H, W) bool; None uses all
    """
    inside, beyond = _parts(image, usable, circle)
    if not inside.shape[1]:
        return False
    cut = _DARK * float(inside.median())
    return bool((beyond <= cut).all() or (beyond == beyond[:, :1]).all()) or _steepest_at_rim(image, usable, circle)


def _parts(image: Tensor, usable: Tensor | None, circle: Circle) -> tuple[Tensor, Tensor]:
    """(3, P) and (3, Q): what is known inside and between the circle and the corners of its square."""
    height, width = image.shape[-2:]
    x, y = torch.arange(width) + 0.5 - circle.x, torch.arange(height)[:, None] + 0.5 - circle.y
    square = (x.abs() <= circle.radius) & (y.abs() <= circle.radius) & torch.isfinite(image).all(0)
    if usable is not None:
        square &= usable[0]
    distance = torch.hypot(x, y)
    beside = max(_BESIDE * circle.radius, circle.radius + 1)
    return image[:, square & (distance < circle.radius)], image[:, square & (distance > beside)]


def _steepest_at_rim(image: Tensor, usable: Tensor | None, circle: Circle) -> bool:
    """Whether radiance changes more across the rim than across circles inside and beyond, near the diagonals."""
    turns = np.radians(np.linspace(-_WIDEST, _WIDEST, _ANGLES) + np.array([[45], [135], [225], [315]])).ravel()
    radii = 1 + np.arange(-_REACH, _REACH + _STEP / 2, _STEP)
    outwards = np.stack([np.cos(turns), np.sin(turns)], -1)[:, None]
    pyramid = Pyramid.of(image, usable)
    level = pyramid.level(circle.radius, 1 / _STEP)
    places = np.array([circle.x, circle.y]) + circle.radius * radii[:, None] * outwards
    values = np.maximum(pyramid.sampled(places, level), 0)
    if not np.isfinite(values).any():
        return False
    steps = np.nanmean(np.abs(np.diff(np.log(values + _DARK * np.nanmedian(values)), axis=1)), axis=(0, 2))
    near = np.abs((radii[1:] + radii[:-1]) / 2 - 1) <= _NEAR
    return bool(steps[near].max() > _STEEP * np.nanmedian(steps[~near]))
