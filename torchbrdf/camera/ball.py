"""`Ball`: a sphere anywhere in the frame of a camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import acos, atan, cos, degrees, hypot, pi, radians, sin, tan

import torch
from torch import Tensor

from torchbrdf.camera.pinhole import PinholeCamera

_OUTLINE = 1024
"""Points of the outline by which its centre and area are found."""

_POLYGON = sin(2 * pi / _OUTLINE) / (2 * pi / _OUTLINE)
"""Share of an ellipse that a polygon of so many points fills."""

_STEPS = 30
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Ball:
    """The cone that touches a sphere, from the camera: its outline is an ellipse, stretched away from the axis.

    direction   from the camera towards the ball's middle, any length; becomes a unit vector
    radius_deg  half the angle across the ball; its sine is the ball's radius over its distance
    Raises ValueError where the ball does not lie wholly before the camera.
    """

    camera: PinholeCamera
    direction: tuple[float, float, float]
    radius_deg: float

    def __post_init__(self) -> None:
        """Check the values."""
        x, y, z = unit_direction(self.direction)
        object.__setattr__(self, "direction", (x, y, z))
        if not (self.radius_deg > 0 and degrees(acos(min(1.0, max(-1.0, -z)))) + self.radius_deg < 90):
            raise ValueError(
                f"the ball must lie wholly before the camera, got one of {self.radius_deg:g} degrees around "
                f"({x:.3f}, {y:.3f}, {z:.3f}), which looks along (0, 0, -1)"
            )

    @classmethod
    def of_circle(cls, camera: PinholeCamera, x: float, y: float, radius: float) -> Ball:
        """The ball whose silhouette has the centre and the area of a circle in the photograph, in pixels.

        Raises ValueError where the camera can see no such ball.
        """
        place, size = (x, y), radius
        for _ in range(_STEPS):
            ball = cls._around(camera, place, size)
            found_x, found_y, found_radius = ball.circle
            place = (place[0] + x - found_x, place[1] + y - found_y)
            size *= radius / found_radius
            if max(abs(found_x - x), abs(found_y - y), abs(found_radius - radius)) < 1e-7 * radius:
                break
        else:
            raise ValueError(
                f"no ball in the {camera} has its silhouette around ({x:g}, {y:g}) with a radius of {radius:g} pixels"
            )
        return ball

    @classmethod
    def _around(cls, camera: PinholeCamera, place: tuple[float, float], size: float) -> Ball:
        """About as large as a circle of `size` pixels around the middle."""
        ray = camera.rays(torch.tensor(place, dtype=torch.float64))
        if not bool(torch.isfinite(ray).all()):
            raise ValueError(f"the {camera} sees nothing at ({place[0]:g}, {place[1]:g})")
        x, y, z = ray.tolist()
        return cls(camera, (x, y, z), degrees(atan(size / camera.focal * (-z) ** 1.5)))

    def __str__(self) -> str:
        """For people."""
        x, y, radius = self.circle
        return f"ball of {self.fov_deg:.3f} degrees at ({x:.1f}, {y:.1f}), radius {radius:.1f} pixels"

    @property
    def fov_deg(self) -> float:
        """The angle across the ball."""
        return 2 * self.radius_deg

    @property
    def off_axis_deg(self) -> float:
        """The angle between the camera's axis and the ball's middle."""
        return degrees(acos(min(1.0, -self.direction[2])))

    @property
    def beside(self) -> str:
        """How far off the axis of which camera, for people."""
        return f"{self.off_axis_deg:.1f} degrees off the axis of a {self.camera}"

    @cached_property
    def rotation(self) -> Tensor:
        """(3, 3) float64: from the frame of the camera turned to look at the ball's middle to the camera's own."""
        return turned_to(self.direction)

    def places(self, x: Tensor, y: Tensor) -> Tensor:
        """(..., 2): where in the photograph the turned camera's square view (..., ) of the ball shows x and y.

        x, y  to the right and up, from -1 to 1 across the ball
        """
        wide = tan(radians(self.radius_deg))
        local = torch.stack([wide * x, wide * y, -torch.ones_like(x)], -1)
        return self.camera.project(local @ self.rotation.to(local).T)

    def contains(self, places: Tensor) -> Tensor:
        """(...) bool: whether places (..., 2) in pixels lie inside the silhouette, to rounding."""
        cosines = self.camera.rays(places) @ places.new_tensor(self.direction)
        return cosines >= cos(radians(self.radius_deg)) - _ROUNDING

    def outline(self, n: int = _OUTLINE) -> Tensor:
        """(n, 2) float64: points of the silhouette in the photograph, in pixels, around the ball."""
        turn = torch.arange(n, dtype=torch.float64) * (2 * pi / n)
        return self.places(torch.cos(turn), torch.sin(turn))

    @cached_property
    def circle(self) -> tuple[float, float, float]:
        """x and y of the silhouette's centre, and the radius of a circle with its area, in pixels."""
        points = self.outline()
        origin = points.mean(0)
        x, y = (points - origin).T
        cross = x * y.roll(-1) - x.roll(-1) * y
        area = cross.sum() / 2
        centre = [float(((axis + axis.roll(-1)) * cross).sum() / (6 * area)) for axis in (x, y)]
        return float(origin[0]) + centre[0], float(origin[1]) + centre[1], float((area.abs() / (pi * _POLYGON)).sqrt())


def unit_direction(direction: Sequence[float]) -> tuple[float, float, float]:
    """Of a direction towards a ball, of any length; raises ValueError for none, or straight behind the camera."""
    x, y, z = (float(each) for each in direction)
    length = hypot(x, y, z)
    if not (0 < length < float("inf") and length - z > 1e-12 * length):
        raise ValueError(f"a direction to a ball must be finite, not 0 and not (0, 0, 1), got ({x:g}, {y:g}, {z:g})")
    return x / length, y / length, z / length


def turned_to(direction: Sequence[float]) -> Tensor:
    """(3, 3) float64: the least rotation that takes (0, 0, -1) to a unit direction."""
    x, y, z = direction
    cross = torch.tensor([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]], dtype=torch.float64)
    return torch.eye(3, dtype=torch.float64) + cross + cross @ cross / (1 - z)
