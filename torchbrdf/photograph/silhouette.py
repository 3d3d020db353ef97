"""Where the ball is in a photograph."""

from dataclasses import dataclass

import numpy as np
from torch import Tensor

_SNAP = 1.5


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


def find_circle(size: tuple[int, int], mask: Tensor | None = None) -> Circle:
    """Where the ball is.

    size  height and width of the photograph
    mask  (1, H, W) bool, True where a pixel's centre shows usable ball; the smallest circle around it is the
          silhouette, so holes (a dimple, a stand) do no harm while some of the rim is left on three sides.
          None: the ball is the inscribed circle of the photograph, and so it is where the mask agrees with that
          to a pixel and a half (masks often leave out the cut pixels of the rim)
    """
    height, width = size
    inscribed = Circle(width / 2, height / 2, min(height, width) / 2)
    if mask is None:
        return inscribed
    if mask.shape != (1, height, width):
        raise ValueError(
            f"mask must have the size of the photograph, {height} x {width}, got {mask.shape[-2]} x {mask.shape[-1]}"
        )
    if not mask.any():
        raise ValueError("mask is empty: no pixel is marked as usable; paint the ball white")
    import cv2

    rows, columns = np.nonzero(mask[0].numpy())
    (x, y), radius = cv2.minEnclosingCircle(np.stack([columns + 0.5, rows + 0.5], axis=1).astype(np.float32))
    distance = max(abs(x - inscribed.x), abs(y - inscribed.y), abs(radius - inscribed.radius))
    return inscribed if distance < _SNAP else Circle(float(x), float(y), float(radius))
