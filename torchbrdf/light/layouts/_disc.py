"""Pictures of the whole sphere inside a disc, u to the right and v up in [-1, 1]."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.light.latlong import area_mean
from torchbrdf.light.layouts._supersampling import lookups

_OVERHANG = 1.0
"""Pixels by which a disc may leave its picture: as little is cut by a crop to whole pixels."""

Circle = tuple[float, float, float]
"""x to the right, y down and the radius, in pixels from the top left corner."""


@dataclass(frozen=True)
class DiscLayout:
    """Where in the disc the light of each direction is.

    coordinates  of unit directions (..., 3) in the frame of the views (the camera looks along -Z, image right is +X,
                 image top is +Y) -> u and v (..., 2)
    solid_angle  of a pixel at a distance from the centre, up to a factor
    edge         pixels by which a pixel's centre must lie inside the disc to be looked at
    """

    coordinates: Callable[[Tensor], Tensor]
    solid_angle: Callable[[Tensor], Tensor]
    edge: float

    def placed(self, size: tuple[int, int], circle: Circle | None, what: str) -> "Disc":
        """The disc in a picture of so many rows and columns; None: it fills a square one.

        Raises ValueError, which begins with `what`, where there is no such disc.
        """
        height, width = size
        if circle is None:
            if height != width or height < 4:
                raise ValueError(
                    f"{what} must be square, got {height} x {width}; crop it to the disc, or say where the disc is: "
                    "--probe-circle X Y R (circle=(x, y, r) in Python)"
                )
            circle = width / 2, height / 2, height / 2
        x, y, radius = circle
        beyond = (radius - x, x + radius - width, radius - y, y + radius - height)
        if not (radius >= 2 and all(pixels <= _OVERHANG for pixels in beyond)):
            raise ValueError(
                f"{what}: a disc around ({x:g}, {y:g}) of radius {radius:g} does not lie in a picture of {height} x "
                f"{width}; give --probe-circle X Y R (circle=(x, y, r) in Python), in pixels from the top left corner"
            )
        return Disc(self, size, (x, y, radius))


@dataclass(frozen=True)
class Disc:
    """A disc in a picture of so many rows and columns."""

    layout: DiscLayout
    size: tuple[int, int]
    circle: Circle

    @property
    def rows(self) -> int:
        """Of a lat-long map about as fine."""
        return round(self.circle[2])

    @property
    def description(self) -> str:
        """In words, for people."""
        x, y, radius = self.circle
        return f"disc around ({x:g}, {y:g}) of radius {radius:g} pixels"

    def weights(self, margin: float = 0.0) -> Tensor:
        """(H, W) float64: the pixels' solid angles up to a factor; 0 where they are not looked at.

        margin  further pixels from the edge
        """
        x, y, radius = self.circle
        down, right = (torch.arange(n, dtype=torch.float64) + 0.5 - c for n, c in zip(self.size, (y, x), strict=True))
        distance = torch.hypot(down[:, None], right[None, :])
        return torch.where(
            distance <= radius - self.layout.edge - margin, self.layout.solid_angle(distance / radius), 0.0
        )

    def to_latlong(self, image: Tensor, height: int) -> Tensor:
        """The lat-long map (channels, height, 2 height) of the picture (channels, H, W).

        Area means of bilinear lookups among the pixels that are looked at. Directions whose point is less than
        sqrt(1/2) pixel further inside are looked up there, near such a pixel.
        """
        x, y, radius = self.circle
        top, left = max(0, math.floor(y - radius)), max(0, math.floor(x - radius))
        around = slice(top, math.ceil(y + radius)), slice(left, math.ceil(x + radius))
        inside = (self.weights() > 0)[around].to(image.device)
        image = image[:, around[0], around[1]]
        channels, rows, columns = image.shape
        texels = torch.cat([image * inside, inside[None].to(image.dtype)]).reshape(channels + 1, -1).t().contiguous()
        limit = 1 - (self.layout.edge + math.sqrt(0.5)) / radius

        def seen_at(places: Tensor) -> Tensor:
            return texels.index_select(0, places.ravel()).unflatten(0, places.shape)

        def radiance_of(directions: Tensor) -> Tensor:
            uv = self.layout.coordinates(directions)
            uv = uv * (limit / torch.hypot(uv[..., 0], uv[..., 1]).clamp_min(limit))[..., None]
            right = uv[..., 0] * radius + (x - left - 0.5)
            down = (y - top - 0.5) - uv[..., 1] * radius
            column, row = right.floor().clamp(0, columns - 2), down.floor().clamp(0, rows - 2)
            s, t = (right - column)[..., None], (down - row)[..., None]
            first = row.long() * columns + column.long()
            upper = torch.lerp(seen_at(first), seen_at(first + 1), s)
            lower = torch.lerp(seen_at(first + columns), seen_at(first + columns + 1), s)
            found = torch.lerp(upper, lower, t)
            return found[..., :-1] / found[..., -1:]

        return area_mean(radiance_of, height, 2 * height, lookups(self.rows, height), image.device)
