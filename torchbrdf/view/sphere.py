"""`SphereView`: a sphere that fills a square image."""

import operator
from math import radians, tan

import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchbrdf.camera import Ball, turned_to, unit_direction
from torchbrdf.lasting import without_autocast
from torchbrdf.view.camera import Framing, Triple, check_fov
from torchbrdf.view.view import SurfacePoints, View

_AHEAD = (0.0, 0.0, -1.0)
_HARDLY_BESIDE = 1e-5
"""Degrees off the axis that count as none: silhouettes are not known to that."""


class SphereView(View):
    """A sphere that touches the borders of a square image.

    size       pixels along a side
    fov_deg    field of view across the image in degrees; None for an orthographic camera
    direction  from the camera towards the sphere's middle, any length, in the camera's frame. The image is that of the
               camera turned to look there, by the least rotation; normals and view directions stay in its own frame,
               which is the probe's
    Pixels that the silhouette cuts are outside the mask: put before a background by it, a ball has a radius of 0.65
    pixels less, and is found to have that. For a photograph, render it some times larger and take means of pixels.
    """

    framing: Framing
    rotation: Tensor
    """(3, 3) float64: from the frame of the camera turned towards the sphere to the camera's own."""

    def __init__(self, size: int, *, fov_deg: float | None = None, direction: Triple = _AHEAD) -> None:
        """Check the arguments and find the pixels that lie wholly inside the silhouette."""
        try:
            self._n = operator.index(size)
        except TypeError:
            raise ValueError(
                f"size of a sphere's image must be one whole number, pixels along a side of the square, got {size!r}"
            ) from None
        if self._n < 3:
            raise ValueError(f"a sphere needs an image of at least 3 x 3 pixels, got size={size}")
        check_fov(fov_deg)
        self.fov_deg = fov_deg
        self.direction = unit_direction(direction)
        self.rotation = turned_to(self.direction)
        self.framing = Framing.of_sphere(fov_deg, self.rotation)
        edge = torch.linspace(-1, 1, self._n + 1, dtype=torch.float64).abs()
        farthest = torch.maximum(edge[:-1], edge[1:]) ** 2
        self.mask = (farthest[:, None] + farthest <= 1)[None]

    @classmethod
    def of_ball(cls, size: int, ball: Ball) -> "SphereView":
        """What the camera of a ball sees of it, its field of view rounded to a thousandth of a degree."""
        direction = ball.direction if ball.off_axis_deg > _HARDLY_BESIDE else _AHEAD
        return cls(size, fov_deg=round(ball.fov_deg, 3), direction=direction)

    def __repr__(self) -> str:
        """Size and camera."""
        camera = "orthographic" if self.fov_deg is None else f"fov_deg={self.fov_deg}"
        where = "" if self._ahead else f", direction=({', '.join(f'{each:.4f}' for each in self.direction)})"
        return f"SphereView({self._n}, {camera}{where}, {len(self.pixels)} pixels)"

    def _identity(self) -> bytes:
        where = "" if self._ahead else f" {self.direction}"
        return f"sphere {self._n} {self.fov_deg}{where}".encode()

    @property
    def coverage(self) -> Tensor:
        """(1, H, W) float32: the share of each pixel inside the silhouette, to 0.05; 1 under the mask."""
        place = torch.linspace(1 / self._n - 1, 1 - 1 / self._n, self._n, dtype=torch.float32)
        inside = (1 - torch.hypot(place[:, None], place)) * (self._n / 2)  # of the pixel's middle, in pixels
        return torch.where(self.mask, 1, (inside + 0.5).clamp(0, 1))

    @property
    def _ahead(self) -> bool:
        return self.direction == _AHEAD

    @without_autocast
    def surface(self, pixels: Tensor, u: Tensor, v: Tensor) -> SurfacePoints:
        """See View."""
        points = self._before_camera(pixels, u, v)
        if self._ahead:
            return points
        turn = self.rotation.to(points.normals)
        normals, view_dirs = (
            torch.einsum("ij,jqs->iqs", turn, vectors) for vectors in (points.normals, points.view_dirs)
        )
        return SurfacePoints(normals, view_dirs)

    def _before_camera(self, pixels: Tensor, u: Tensor, v: Tensor) -> SurfacePoints:
        """In the frame of the camera turned towards the sphere."""
        x = (2 / self._n) * ((pixels % self._n)[:, None] + u) - 1
        y = 1 - (2 / self._n) * ((pixels // self._n)[:, None] + v)
        if self.fov_deg is None:
            z = torch.sqrt((1 - x * x - y * y).clamp_min(0))
            toward_camera = torch.zeros(3, 1, 1, dtype=x.dtype, device=x.device)
            toward_camera[2] = 1
            return SurfacePoints(torch.stack([x, y, z]), toward_camera.expand(3, *x.shape))
        half = radians(self.fov_deg) / 2
        distance = self.framing.distance
        ray = normalize(torch.stack([x * tan(half), y * tan(half), -torch.ones_like(x)]), dim=0)
        along = -distance * ray[2]
        t = along - torch.sqrt((along * along - distance * distance + 1).clamp_min(0))
        hit = t * ray
        hit[2] += distance
        return SurfacePoints(normalize(hit, dim=0), -ray)
