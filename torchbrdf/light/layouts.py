"""Angular maps and mirror balls, resampled to lat-long.

Both are square images of the whole sphere inside the inscribed disc, u to the right and v up in [-1, 1]:

- angular map (Debevec's `*_probe`): the centre looks forward, along -Z, with +X right and +Y up; the angle
  from -Z is pi sqrt(u^2 + v^2), so the rim is straight behind (+Z) [Deb98];
- mirror ball: a photograph of a perfectly reflecting sphere by a distant camera that looks along -Z: the
  normal is (u, v, sqrt(1 - u^2 - v^2)), so the centre shows what is behind the camera (+Z), the rim -Z.

Both are in the frame of the views (the camera looks along -Z, image right is +X, image top is +Y).
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from torchbrdf.light.latlong import area_mean

_SUPERSAMPLING = 6
# How far inside the disc a pixel's centre must be: those that a photographed silhouette cuts hold background.
_EDGE = {"angular": 0.0, "mirror_ball": math.sqrt(0.5)}


def angular_map_to_latlong(image: Tensor, height: int) -> Tensor:
    """The lat-long map (3, height, 2 height) of an angular map (3, N, N)."""
    return _disc_to_latlong(image, _angular_coordinates, _EDGE["angular"], height)


def mirror_ball_to_latlong(image: Tensor, height: int) -> Tensor:
    """The lat-long map (3, height, 2 height) of an orthographic photograph (3, N, N) of a mirror ball."""
    return _disc_to_latlong(image, _mirror_ball_coordinates, _EDGE["mirror_ball"], height)


def pixels_in_disc(size: int, layout: str) -> Tensor:
    """(size, size) bool: the pixels of an "angular" or "mirror_ball" image that are looked at."""
    return _disc(size, _EDGE[layout])


def _disc(size: int, edge: float) -> Tensor:
    centres = torch.arange(size) - (size - 1) / 2
    return torch.hypot(centres[:, None], centres[None, :]) <= size / 2 - edge


def _angular_coordinates(directions: Tensor) -> Tensor:
    d_x, d_y, d_z = directions.unbind(-1)
    sine = torch.hypot(d_x, d_y)
    radius = torch.atan2(sine, -d_z) / math.pi
    return directions[..., :2] * (radius / sine.clamp_min(1e-12))[..., None]


def _mirror_ball_coordinates(directions: Tensor) -> Tensor:
    # The normal bisects the direction and the view +Z. From |(d_x, d_y)| near -Z, where 1 + d_z cancels.
    d_x, d_y, d_z = directions.unbind(-1)
    sine = torch.hypot(d_x, d_y)
    radius = torch.sin(torch.atan2(sine, d_z) / 2)
    return directions[..., :2] * (radius / sine.clamp_min(1e-12))[..., None]


def _disc_to_latlong(
    image: Tensor, coordinates: Callable[[Tensor], Tensor], edge: float, height: int
) -> Tensor:
    """Area means of bilinear lookups among the pixels whose centre is at least `edge` pixels inside the disc.

    Directions whose point is less than sqrt(1/2) pixel further inside are looked up there, near such a pixel.
    """
    size = image.shape[-1]
    inside = _disc(size, edge).to(image.device)
    texels = torch.cat([image * inside, inside[None].to(image.dtype)]).reshape(4, -1).t().contiguous()
    limit = 1 - 2 * (edge + math.sqrt(0.5)) / size

    def radiance_of(directions: Tensor) -> Tensor:
        uv = coordinates(directions)
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
