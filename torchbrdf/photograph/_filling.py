"""Whether a crop shows that a ball fills it, or a smaller one before one value."""

from __future__ import annotations

from math import pi

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, max_pool2d

from torchbrdf.photograph._pyramid import Pyramid
from torchbrdf.photograph.silhouette import SNAP, Circle

_BESIDE = 1.02
"""Radii from which on a pixel lies beyond the rim."""

_DARK = 0.02
"""Of the median radiance inside: what lies beyond and is darker is cut away."""

_RIM = 1.5
"""Pixels of the width of the rim of a ball that is cut out."""

_REACH, _STEP, _NEAR, _ANGLES = 0.15, 0.01, 0.02, 31
"""Radii on either side in which steps are compared, their length, and how near the rim is one of it."""

_WIDEST = 11.0
"""Degrees from a diagonal within which rays stay in the crop."""

_STEEP = 2.0
"""How many times the usual step of radiance that at the rim is."""

_LAST, _CUT, _MISSING = 2.0, 0.75, 0.05
"""Pixels inside a rim between which none that is whole is missing but this share, whether those that it cuts are left
out or not."""


def apart(image: Tensor, usable: Tensor | None, circle: Circle) -> Circle | None:
    """The ball in a crop that is smaller than its inscribed circle, with one value all around it; None for none.

    So renderers write it. Its area counts a pixel of the outline by how far it is from the background to what lies
    inside of it, as such pixels show both.
    """
    distance, known = _square(image, usable, circle)
    beyond = image[:, known & _beyond(distance, circle)]
    if not beyond.shape[1] or not _uniform(beyond):
        return None
    away = torch.where(known, (image - beyond[:, :1, None]).abs().sum(0), 0)
    shown = away > 0
    last = shown[known & (distance > circle.radius - _LAST) & (distance < circle.radius - _CUT)]
    if not shown.any() or not last.numel() or float(last.float().mean()) > 1 - _MISSING:
        return None
    inside = max_pool2d((~shown).float()[None], 3, 1, 1)[0] == 0
    near, count = (avg_pool2d(part[None], 5, 1, 2, divisor_override=1)[0] for part in (away * inside, inside.float()))
    share = torch.where(inside, 1.0, (away * count / near.clamp_min(torch.finfo(near.dtype).tiny)).clamp(0, 1))
    y, x = (float((places + 0.5).double().mean()) for places in shown.nonzero(as_tuple=True))
    radius = (float((share * shown).sum(dtype=torch.float64)) / pi) ** 0.5
    if radius < _RIM:
        return None
    ball = Circle(x, y, radius)
    offset, _ = _square(image, usable, ball)
    whole = bool(shown[offset < radius - 1].all()) and not bool(shown[offset > radius + 1].any())
    return ball if whole else None


def fills(image: Tensor, usable: Tensor | None, circle: Circle) -> bool:
    """Whether what lies between an inscribed circle and the corners is cut away, or a rim is seen there.

    image   (3, H, W)
    usable  (1, H, W) bool; None uses all
    """
    distance, known = _square(image, usable, circle)
    inside, beyond = image[:, known & (distance < circle.radius)], image[:, known & _beyond(distance, circle)]
    if not inside.shape[1]:
        return False
    cut = _DARK * float(inside.median())
    return bool((beyond <= cut).all() or _uniform(beyond)) or _steepest_at_rim(image, usable, circle)


def cut_out(image: Tensor, usable: Tensor | None, circle: Circle) -> bool:
    """Whether a crop was cut along an inscribed circle: one value or none beyond it, and only others at the rim."""
    distance, known = _square(image, usable, circle)
    beyond = image[:, known & _beyond(distance, circle)]
    rim = (distance < circle.radius - SNAP) & (distance > circle.radius - SNAP - _RIM)
    if not _uniform(beyond) or not rim.any():
        return False
    return bool(known[rim].all() and (beyond.shape[1] == 0 or (image[:, rim] != beyond[:, :1]).any(0).all()))


def _square(image: Tensor, usable: Tensor | None, circle: Circle) -> tuple[Tensor, Tensor]:
    """(H, W): the distance from a circle's middle, and whether it is known what its square shows there."""
    height, width = image.shape[-2:]
    x, y = (torch.arange(n, dtype=torch.float32) + 0.5 - at for n, at in ((width, circle.x), (height, circle.y)))
    y = y[:, None]
    known = (x.abs() <= circle.radius) & (y.abs() <= circle.radius) & torch.isfinite(image).all(0)
    return torch.hypot(x, y), known if usable is None else known & usable[0]


def _beyond(distance: Tensor, circle: Circle) -> Tensor:
    return distance > max(_BESIDE * circle.radius, circle.radius + 1)


def _uniform(pixels: Tensor) -> bool:
    """Whether pixels (3, Q) are all the same, be it that there are none."""
    return bool((pixels == pixels[:, :1]).all())


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
