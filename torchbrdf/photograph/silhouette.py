"""Where the ball is in a photograph."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import atan, degrees, pi

import numpy as np
import torch
from torch import Tensor

from torchbrdf.arguments import warn
from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.images import Window
from torchbrdf.photograph._checks import check_mask

_ROUNDING = 1e-9
SNAP = 1.5
_SMALLEST_PART = 0.02
"""Of the largest connected part: smaller ones are strays."""

_RIM = 0.02
_DIRECTIONS = 180
_LEAST_RIM, _LITTLE_RIM = 0.1, 0.5
"""Share of the directions in which a mask reaches the rim of its circle: below it the circle is none, or uncertain."""

_LITTLE_FILL = 0.3
_MUCH_BESIDE = 0.1
_INVERTED_FILL = 0.85
_UNITS = 1000
"""Across places whose smallest circle is sought: OpenCV takes them in float32, and 1e-4 of a unit for nothing."""

_CONES = 2
"""Times that the smallest cone is sought: each begins about the last, where a circle is nearly one."""


@dataclass(frozen=True)
class Circle:
    """The silhouette of a ball in a photograph, in pixels: x to the right, y down, (0, 0) the top left corner."""

    x: float
    y: float
    radius: float

    def __post_init__(self) -> None:
        """Check that a view of the ball can be made."""
        if not 1.5 <= self.radius < float("inf"):
            raise ValueError(f"the ball must be at least 3 pixels across, got a radius of {self.radius}")

    def __str__(self) -> str:
        """For people."""
        return f"circle at ({self.x:.1f}, {self.y:.1f}), radius {self.radius:.1f} pixels"

    @classmethod
    def inscribed(cls, window: Window) -> Circle:
        """The largest in the middle of a rectangle."""
        centre = window.left + window.width / 2, window.top + window.height / 2
        return cls(*centre, min(window.width, window.height) / 2)

    def differs(self, other: Circle) -> float:
        """By how many pixels, at most, in place or radius."""
        return max(abs(self.x - other.x), abs(self.y - other.y), abs(self.radius - other.radius))

    @property
    def circle(self) -> tuple[float, float, float]:
        """x, y and radius, as of a `Ball`."""
        return self.x, self.y, self.radius

    def places(self, x: Tensor, y: Tensor) -> Tensor:
        """(..., 2): where in the photograph x and y (...) are, to the right and up, from -1 to 1 across the ball."""
        return torch.stack([self.x + self.radius * x, self.y - self.radius * y], -1)

    def outline(self, n: int = 256) -> Tensor:
        """(n, 2) float64: points of it in the photograph, in pixels."""
        turn = torch.arange(n, dtype=torch.float64) * (2 * pi / n)
        return self.places(torch.cos(turn), torch.sin(turn))

    def contains(self, places: Tensor) -> Tensor:
        """(...) bool: whether places (..., 2) in pixels lie inside, to rounding."""
        return torch.hypot(places[..., 0] - self.x, places[..., 1] - self.y) <= self.radius * (1 + _ROUNDING)

    def holds(self, height: int, width: int) -> Tensor:
        """(height, width) bool: the pixels of a photograph whose centres lie inside."""
        x, y = (torch.arange(n, dtype=torch.float32) + 0.5 - at for n, at in ((width, self.x), (height, self.y)))
        return torch.hypot(x, y[:, None]) <= self.radius

    def leaves(self, height: int, width: int) -> bool:
        """Whether it leaves a photograph on two opposite sides, by more than rounding."""
        slack = max(SNAP, _RIM * self.radius)
        beyond = [self.radius - slack - distance for distance in (self.x, width - self.x, self.y, height - self.y)]
        return min(beyond[:2]) > 0 or min(beyond[2:]) > 0


def find_circle(size: tuple[int, int], mask: Tensor | None = None, window: Window | None = None) -> Circle:
    """Where the ball is.

    size    height and width of the photograph
    mask    (1, H, W) bool, True where a pixel's centre shows usable ball; the smallest circle around it is the
            silhouette, so holes (a dimple, a stand) do no harm while half of the rim is left. Stray pixels do not
            count: the circle is that of the largest connected part, or of all large ones if they fill theirs better.
            None: the ball is the inscribed circle of the photograph, and so it is where the mask agrees with that
            to a pixel and a half (masks often leave out the cut pixels of the rim)
    window  the part of the photograph that was recorded, whose inscribed circle counts instead; None for all
    Warns where the circle is a guess: no mask in an oblong photograph, or a mask that follows little of the rim.
    Raises ValueError where the mask marks no ball, is not bool, or is of another size than the photograph.
    """
    height, width = size
    whole = Circle.inscribed(Window(0, 0, width, height))
    if mask is None:
        return _inscribed(whole, window, size)
    check_mask(mask, height, width)
    if not mask.any():
        raise ValueError("mask is empty: no pixel is marked as usable; paint the ball white")
    found = _Marked.best(mask[0].numpy())
    if found.circle.differs(whole) < SNAP:
        return whole
    _check(found, mask[0].numpy())
    return found.circle


def find_ball(camera: PinholeCamera, mask: Tensor | None = None, window: Window | None = None) -> Ball:
    """Where the ball is before the photograph's camera: as `find_circle`, by the smallest cone around a mask.

    mask    (1, H, W) bool, True where usable ball is; None: the inscribed circle of the photograph
    window  the part that was recorded, whose inscribed circle counts instead; None for all
    """
    height, width = camera.size
    circle = find_circle(camera.size, mask, window)
    ball = Ball.of_circle(camera, circle.x, circle.y, circle.radius)
    if mask is None or circle == Circle.inscribed(Window(0, 0, width, height)):
        return ball
    places = _Marked.best(mask[0].numpy()).places
    for _ in range(_CONES):
        seen = camera.rays(places) @ ball.rotation
        x, y, radius = _smallest_circle((seen[:, :2] / -seen[:, 2:]).numpy())
        direction = ball.rotation @ torch.tensor([x, y, -1.0], dtype=torch.float64)
        ball = Ball(camera, (float(direction[0]), float(direction[1]), float(direction[2])), degrees(atan(radius)))
    return ball


def _inscribed(whole: Circle, window: Window | None, size: tuple[int, int]) -> Circle:
    """Of the recorded part where that is a crop of its own, and else of the photograph."""
    height, width = size
    if window is not None:
        circle = Circle.inscribed(window)
        square = abs(window.width - window.height) < SNAP
        if circle.differs(whole) >= SNAP and (square or abs(width - height) >= SNAP):
            if not square:
                warn(f"no mask: the ball is taken to fill the {window.height} x {window.width} pixels recorded")
            return circle
    if abs(width - height) >= SNAP:
        warn(f"no mask: the ball is taken to fill the middle of the {height} x {width} photograph")
    return whole


@dataclass(frozen=True)
class _Marked:
    """Pixels (H, W) bool that may show a ball, and the smallest circle around them."""

    pixels: np.ndarray

    @classmethod
    def best(cls, mask: np.ndarray) -> _Marked:
        """The largest connected part, or all large ones together where they fill their circle better."""
        import cv2

        _, labels, found, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
        areas = found[1:, cv2.CC_STAT_AREA]
        large = cls(np.isin(labels, 1 + np.flatnonzero(areas >= _SMALLEST_PART * areas.max())))
        largest = cls(labels == 1 + areas.argmax())
        return max(large, largest, key=lambda one: one.fill)

    @cached_property
    def circle(self) -> Circle:
        """The smallest that holds all pixels' centres."""
        return Circle(*_smallest_circle(self.places.numpy()))

    @cached_property
    def places(self) -> Tensor:
        """(N, 2) float64: the pixels' centres, x and y."""
        rows, columns = np.nonzero(self.pixels)
        return torch.from_numpy(np.stack([columns + 0.5, rows + 0.5], axis=1))

    @cached_property
    def fill(self) -> float:
        """Share of the circle's pixels, inside the photograph, that are marked."""
        inside = self.circle.holds(*self.pixels.shape).numpy()
        return float(self.pixels[inside].mean()) if inside.any() else 0.0

    @cached_property
    def rim(self) -> float:
        """Share of the directions in which pixels are marked at the circle's rim."""
        rows, columns = np.nonzero(self.pixels)
        x, y = columns + 0.5 - self.circle.x, rows + 0.5 - self.circle.y
        near = np.hypot(x, y) >= self.circle.radius - max(SNAP, _RIM * self.circle.radius)
        bins = min(_DIRECTIONS, int(np.pi * self.circle.radius))  # at least two pixels of the rim in each
        turned = np.arctan2(y[near], x[near]) / (2 * np.pi) * bins
        return len(np.unique(np.floor(turned).astype(int) % bins)) / bins


def _smallest_circle(places: np.ndarray) -> tuple[float, float, float]:
    """x, y and radius of the smallest that holds all places (N, 2), to 1e-6 of its radius."""
    import cv2

    low, high = places.min(0), places.max(0)
    middle, unit = (low + high) / 2, max(float((high - low).max()), 1e-300) / _UNITS
    (x, y), radius = cv2.minEnclosingCircle(((places - middle) / unit).astype(np.float32))
    return float(middle[0] + unit * x), float(middle[1] + unit * y), unit * radius


def _check(found: _Marked, mask: np.ndarray) -> None:
    """Raise where a mask is no ball; warn where little of it is."""
    if found.circle.leaves(*mask.shape):
        inside = None if mask.all() else _Marked.best(~mask)
        if inside is not None and inside.fill > _INVERTED_FILL and not inside.circle.leaves(*mask.shape):
            raise ValueError(
                f"the mask marks what lies around a ball, {inside.circle}, and not the ball; paint the ball white, or "
                "give --invert-mask (~mask in Python)"
            )
        raise ValueError(
            f"the mask's silhouette, a {found.circle}, leaves the photograph on opposite sides; mark the ball alone, "
            "or give its circle: --circle X Y R"
        )
    seen = f"the mask fills {found.fill:.0%} of its {found.circle}, and follows {found.rim:.0%} of the rim"
    if found.rim < _LEAST_RIM:
        raise ValueError(f"{seen}: it marks no ball; mark all of it, or give its circle: --circle X Y R")
    if found.rim < _LITTLE_RIM or found.fill < _LITTLE_FILL:
        warn(f"{seen}: the silhouette may be wrong; --circle X Y R gives it")
    beside = mask & ~found.circle.holds(*mask.shape).numpy()
    if beside.sum() > _MUCH_BESIDE * mask.sum():
        share = beside.sum() / mask.sum()
        warn(f"{share:.0%} of the mask lie beside its largest part, a {found.circle}, and are not used")
