"""`PinholeCamera`: which direction each place of a photograph looks in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import atan, degrees, radians, tan
from numbers import Integral

import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchbrdf.camera._distortion import Distortion

_BORDER = 32
"""Places along each side of the photograph at which a lens must be one to one."""


@dataclass(frozen=True)
class PinholeCamera:
    """The camera of a whole photograph. It looks along -Z; image right is +X, image top is +Y.

    size        height and width in pixels
    focal       length in pixels, which are square
    principal   x and y where it looks, in pixels from the top left corner of the photograph; None for its middle.
                OpenCV counts from the middle of the first pixel: its c_x and c_y are less by 1/2
    distortion  of the lens, as OpenCV's: k1 k2 p1 p2, then k3, then k4 k5 k6, then s1 s2 s3 s4; none for none
    Raises ValueError for values that are no camera, or a lens that folds the photograph over.
    """

    size: tuple[int, int]
    focal: float
    principal: tuple[float, float] | None = None
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Check the values."""
        if len(self.size) != 2 or not all(isinstance(n, Integral) and n > 0 for n in self.size):
            raise ValueError(f"the size must be height and width, two whole numbers above 0, got {self.size}")
        if not 0 < self.focal < float("inf"):
            raise ValueError(f"the focal length must be positive and finite, got {self.focal:g} pixels")
        if self.principal is not None and not all(
            0 <= p <= n for p, n in zip(self.principal, self._extent, strict=True)
        ):
            raise ValueError(
                "the principal point must lie in the photograph, "
                f"{self.size[0]} x {self.size[1]}, got {self.principal[0]:g}, {self.principal[1]:g}"
            )
        if self._lens is not None and not bool(torch.isfinite(self.rays(self._border)).all()):
            raise ValueError(
                f"the {self._lens} folds the photograph over; give OpenCV's k1 k2 p1 p2 [k3 ...], found for this focal "
                "length"
            )

    @classmethod
    def of_fov(
        cls,
        size: tuple[int, int],
        fov_deg: float,
        principal: tuple[float, float] | None = None,
        distortion: Sequence[float] = (),
    ) -> PinholeCamera:
        """By its field of view across the width of the photograph, in degrees, without the lens's distortion."""
        if not 0 < fov_deg < 180:
            raise ValueError(f"the field of view must lie between 0 and 180 degrees, got {fov_deg:g}")
        return cls(size, size[1] / 2 / tan(radians(fov_deg) / 2), principal, tuple(distortion))

    @classmethod
    def of_focal(
        cls,
        size: tuple[int, int],
        focal_mm: float,
        sensor_mm: float,
        principal: tuple[float, float] | None = None,
        distortion: Sequence[float] = (),
    ) -> PinholeCamera:
        """By its focal length and the width of its sensor, which the longer side of the photograph spans."""
        if not (0 < focal_mm < float("inf") and 0 < sensor_mm < float("inf")):
            raise ValueError(f"focal length and sensor must be positive, got {focal_mm:g} and {sensor_mm:g} mm")
        return cls(size, focal_mm / sensor_mm * max(size), principal, tuple(distortion))

    def __str__(self) -> str:
        """For people."""
        lens = "" if self._lens is None else f", {self._lens}"
        return f"camera of {self.fov_deg:.4g} degrees across{lens}"

    @property
    def fov_deg(self) -> float:
        """Across the width of the photograph, as if the principal point were its middle and the lens a pinhole."""
        return 2 * degrees(atan(self.size[1] / 2 / self.focal))

    @property
    def axis(self) -> tuple[float, float]:
        """Where the camera looks: x and y in pixels."""
        return (self.size[1] / 2, self.size[0] / 2) if self.principal is None else self.principal

    def project(self, directions: Tensor) -> Tensor:
        """Places (..., 2), x to the right and y down in pixels, of directions (..., 3) of any length; differentiable.

        NaN where a direction does not lie before the camera.
        """
        x, y, z = directions.unbind(-1)
        before = torch.where(z < 0, -z, torch.nan)
        seen = torch.stack([x / before, -y / before], -1)
        if self._lens is not None:
            seen = self._lens.apply(seen)
        return self.focal * seen + seen.new_tensor(self.axis)

    def rays(self, places: Tensor) -> Tensor:
        """Unit directions (..., 3) of places (..., 2) in pixels; NaN where the lens shows none there."""
        seen = (places - places.new_tensor(self.axis)) / self.focal
        if self._lens is not None:
            seen = self._lens.undo(seen)
        x, y = seen.unbind(-1)
        return normalize(torch.stack([x, -y, -torch.ones_like(x)], -1), dim=-1)

    @cached_property
    def _lens(self) -> Distortion | None:
        return Distortion(self.distortion) if any(self.distortion) else None

    @property
    def _extent(self) -> tuple[int, int]:
        return self.size[1], self.size[0]

    @property
    def _border(self) -> Tensor:
        t = torch.linspace(0, 1, _BORDER, dtype=torch.float64)
        low, high = torch.zeros_like(t), torch.ones_like(t)
        sides = [(t, low), (t, high), (low, t), (high, t)]
        return torch.cat([torch.stack(side, -1) for side in sides]) * t.new_tensor(self._extent)
