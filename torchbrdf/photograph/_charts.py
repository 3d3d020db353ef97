"""Planes in which the outline of every ball is a circle."""

from __future__ import annotations

from math import atan, atan2, degrees, hypot, radians, tan
from typing import Protocol

import numpy as np
import torch

from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.photograph.silhouette import Circle

_SIDE_POINTS = 9


class Chart(Protocol):
    """A plane, in about the photograph's pixels."""

    def to_photograph(self, points: np.ndarray) -> np.ndarray:
        """Places (..., 2) in the photograph of points (..., 2) of the plane."""

    def extent(self, size: tuple[int, int]) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of a photograph of a size in the plane."""

    def silhouette(self, x: float, y: float, radius: float) -> Circle | Ball:
        """Of the ball whose outline is that circle in the plane; raises ValueError where none is."""

    def circle(self, silhouette: Circle | Ball) -> tuple[float, float, float]:
        """x, y and radius of a silhouette in the plane."""


class PhotographChart:
    """The photograph itself, where no camera is known: right for balls on its axis."""

    def to_photograph(self, points: np.ndarray) -> np.ndarray:
        """The points."""
        return points

    def extent(self, size: tuple[int, int]) -> tuple[float, float, float, float]:
        """The photograph's border."""
        return 0.0, 0.0, float(size[1]), float(size[0])

    def silhouette(self, x: float, y: float, radius: float) -> Circle | Ball:
        """The circle."""
        return Circle(float(x), float(y), float(radius))

    def circle(self, silhouette: Circle | Ball) -> tuple[float, float, float]:
        """Its own."""
        return silhouette.circle


class StereographicChart:
    """The stereographic picture of a camera's directions, which takes circles on the sphere to circles.

    A direction at an angle t to the axis lies 2 f tan(t / 2) from the principal point, f the focal length in pixels.
    """

    def __init__(self, camera: PinholeCamera) -> None:
        """Of that camera."""
        self.camera = camera
        self._middle = np.array(camera.axis)
        self._unit = 2 * camera.focal

    def to_photograph(self, points: np.ndarray) -> np.ndarray:
        """As the camera projects their directions."""
        right, down = np.moveaxis((points - self._middle) / self._unit, -1, 0)
        square = right**2 + down**2
        directions = np.stack([2 * right, -2 * down, square - 1], -1)
        places: np.ndarray = self.camera.project(torch.from_numpy(directions)).numpy()
        return places

    def extent(self, size: tuple[int, int]) -> tuple[float, float, float, float]:
        """Of the photograph's border."""
        t = np.linspace(0, 1, _SIDE_POINTS)
        sides = [(t, 0 * t), (t, 0 * t + 1), (0 * t, t), (0 * t + 1, t)]
        border = np.concatenate([np.stack(side, -1) for side in sides]) * (size[1], size[0])
        rays = self.camera.rays(torch.from_numpy(border)).numpy()
        points = self._middle + self._unit * rays[:, :2] * (1, -1) / (1 - rays[:, 2:])
        left, top = points.min(0).tolist()
        right, bottom = points.max(0).tolist()
        return left, top, right, bottom

    def silhouette(self, x: float, y: float, radius: float) -> Circle | Ball:
        """The cone: its nearest and its farthest direction from the axis lie on a line through the principal point."""
        right, down = (float(each) / self._unit for each in (x - self._middle[0], y - self._middle[1]))
        away = hypot(right, down)
        near, far = 2 * atan(away - radius / self._unit), 2 * atan(away + radius / self._unit)
        turn = np.tan((near + far) / 2) / away if away > 0 else 0.0
        return Ball(self.camera, (right * turn, -down * turn, -1.0), degrees(far - near) / 2)

    def circle(self, silhouette: Circle | Ball) -> tuple[float, float, float]:
        """Of a ball before this camera."""
        assert isinstance(silhouette, Ball)
        right, up, towards = silhouette.direction
        across = hypot(right, up)
        angle, reach = atan2(across, -towards), radians(silhouette.radius_deg)
        near, far = tan((angle - reach) / 2), tan((angle + reach) / 2)
        away = self._unit / 2 * (near + far) / across if across > 0 else 0.0
        x, y = self._middle.tolist()
        return x + away * right, y - away * up, self._unit / 2 * (far - near)


def chart_of(camera: PinholeCamera | None) -> Chart:
    """For a camera, or for none."""
    return PhotographChart() if camera is None else StereographicChart(camera)
