"""A photograph at several sizes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

_SMALLEST = 48


@dataclass(frozen=True)
class Pyramid:
    """A photograph (H, W, 3) float32, NaN where it may not be used, and its means over squares of 2, 4, ... pixels.

    corner  x and y of the part that it holds, in the photograph
    """

    levels: list[np.ndarray]
    corner: tuple[int, int] = (0, 0)

    @classmethod
    def of(cls, image: Tensor, usable: Tensor | None = None, corner: tuple[int, int] = (0, 0)) -> Pyramid:
        """Of a photograph (3, H, W) and which pixels (1, H, W) of it may be used; halved while 48 are left."""
        import cv2

        sound = torch.isfinite(image).all(0) if usable is None else torch.isfinite(image).all(0) & usable[0]
        levels = [torch.where(sound, image, torch.nan).permute(1, 2, 0).float().contiguous().numpy()]
        while min(levels[-1].shape[:2]) >= 2 * _SMALLEST:
            height, width = (side // 2 for side in levels[-1].shape[:2])
            even = levels[-1][: 2 * height, : 2 * width]
            levels.append(cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA))
        return cls(levels, corner)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of what it holds."""
        return self.levels[0].shape[0], self.levels[0].shape[1]

    def level(self, pixels: float, wanted: float) -> int:
        """At which what measures some pixels in the photograph is about as large as wanted, or larger."""
        return min(max(round(float(np.log2(max(pixels, 1) / wanted))), 0), len(self.levels) - 1)

    def sampled(self, places: np.ndarray, level: int) -> np.ndarray:
        """(M, N, 3) at places (M, N, 2) of the photograph, between pixels of a level; NaN beyond its border."""
        import cv2

        x, y = np.moveaxis(((places - self.corner) / 2**level - 0.5).astype(np.float32), -1, 0)
        picture, beyond = self.levels[level], (np.nan,) * 4
        return np.asarray(
            cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=beyond)
        )
