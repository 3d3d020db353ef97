"""Square images of the whole sphere inside the inscribed disc, u to the right and v up in [-1, 1]."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.light.latlong import area_mean

_SUPERSAMPLING = 6


@dataclass(frozen=True)
class DiscLayout:
    """Where in the disc the light of each direction is.

    coordinates  of unit directions (..., 3) in the frame of the views (the camera looks along -Z, image right is +X,
                 image top is +Y) -> u and v (..., 2)
    edge         pixels by which a pixel's centre must lie inside the disc to be looked at
    """

    coordinates: Callable[[Tensor], Tensor]
    edge: float

    def pixels(self, size: int) -> Tensor:
        """(size, size) bool: the pixels of an image that are looked at."""
        centres = torch.arange(size) - (size - 1) / 2
        return torch.hypot(centres[:, None], centres[None, :]) <= size / 2 - self.edge

    def to_latlong(self, image: Tensor, height: int) -> Tensor:
        """The lat-long map (3, height, 2 height) of an image (3, N, N).

        Area means of bilinear lookups among the pixels that are looked at. Directions whose point is less than
        sqrt(1/2) pixel further inside are looked up there, near such a pixel.
        """
        size = image.shape[-1]
        inside = self.pixels(size).to(image.device)
        texels = torch.cat([image * inside, inside[None].to(image.dtype)]).reshape(4, -1).t().contiguous()
        limit = 1 - 2 * (self.edge + math.sqrt(0.5)) / size

        def radiance_of(directions: Tensor) -> Tensor:
            uv = self.coordinates(directions)
            radius = torch.hypot(uv[..., 0], uv[..., 1])
            uv = uv * (limit / radius.clamp_min(limit))[..., None]
            x = (1 + uv[..., 0]) * (size / 2) - 0.5
            y = (1 - uv[..., 1]) * (size / 2) - 0.5
            column, row = x.floor().clamp(0, size - 2), y.floor().clamp(0, size - 2)
            s, t = (x - column)[..., None], (y - row)[..., None]
            first = row.long() * size + column.long()
            upper = torch.lerp(texels[first], texels[first + 1], s)
            lower = torch.lerp(texels[first + size], texels[first + size + 1], s)
            found = torch.lerp(upper, lower, t)
            return found[..., :3] / found[..., 3:]

        return area_mean(radiance_of, height, 2 * height, _SUPERSAMPLING, image.device)
