"""`SphereView`: a sphere that fills a square image."""

from math import radians, tan

import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchbrdf.view.camera import Framing, check_fov
from torchbrdf.view.view import SurfacePoints, View


class SphereView(View):
    """A sphere that touches the borders of a square image.

    size     pixels along a side
    fov_deg  field of view across the image in degrees; None for an orthographic camera
    Pixels that the silhouette cuts are outside the mask.
    """

    framing: Framing

    def __init__(self, size: int, fov_deg: float | None = None) -> None:
        """Check the arguments and find the pixels that lie wholly inside the silhouette."""
        if size < 3:
            raise ValueError(f"a sphere needs an image of at least 3 x 3 pixels, got size={size}")
        check_fov(fov_deg)
        self.fov_deg = fov_deg
        self.framing = Framing.of_sphere(fov_deg)
        self._n = int(size)
        edge = torch.linspace(-1, 1, self._n + 1, dtype=torch.float64).abs()
        farthest = torch.maximum(edge[:-1], edge[1:]) ** 2
        self.mask = (farthest[:, None] + farthest <= 1)[None]

    def __repr__(self) -> str:
        """Size and camera."""
        camera = "orthographic" if self.fov_deg is None else f"fov_deg={self.fov_deg}"
        return f"SphereView({self._n}, {camera}, {len(self.pixels)} pixels)"

    def _identity(self) -> bytes:
        return f"sphere {self._n} {self.fov_deg}".encode()

    def surface(self, pixels: Tensor, u: Tensor, v: Tensor) -> SurfacePoints:
        """See View."""
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
