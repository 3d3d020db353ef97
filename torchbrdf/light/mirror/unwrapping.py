"""`Seen`: the part of the light that a photograph shows, in a mirror ball and beside it, on a lat-long map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, floor, pi

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from torchbrdf.camera import Ball
from torchbrdf.light.latlong import CPU_CHUNK, area_mean, directions_at
from torchbrdf.light.mirror.pixels import inside, touched
from torchbrdf.light.mirror.reflection import Reflection

_LOOKUPS = 3
"""Along a side of a texel as wide as a pixel in the middle of the ball: towards the rim pixels are narrower across its
radius, up to about three a texel. Of the surroundings, whose pixels are first averaged to about as many a texel."""

_LEAST_SEEN = 0.5
"""Share of a texel's lookups that must meet usable pixels."""

_MARGIN = 2.0
"""Pixels around the silhouette that are not looked at directly: optics spread the ball over them."""

Reflectance = Callable[[Tensor], Tensor]
"""From the angle of incidence (...) in radians to the share that is reflected (..., 3)."""


@dataclass(frozen=True)
class Seen:
    """Radiance from some of the directions.

    radiance  (3, H, 2 H) float32, 0 where nothing was seen
    weight    (H, 2 H) float32: how sharply, 1 in the middle of a ball; 0 where nothing was seen
    """

    radiance: Tensor
    weight: Tensor

    @property
    def known(self) -> Tensor:
        """(H, 2 H) bool."""
        return self.weight > 0

    def completed(self, other: Seen) -> Seen:
        """With what another saw where this one saw nothing."""
        return Seen(
            torch.where(self.known, self.radiance, other.radiance), torch.where(self.known, self.weight, other.weight)
        )

    def averaged(self, other: Seen) -> Seen:
        """The mean of both where both saw, by weight to the fourth power: mostly the sharper one, without a seam."""
        mine, others = self.weight**4, other.weight**4
        total = mine + others
        mean = (self.radiance * mine + other.radiance * others) / torch.where(total > 0, total, 1.0)
        return Seen(mean, torch.maximum(self.weight, other.weight))


def reflected(
    image: Tensor,
    usable: Tensor,
    reflection: Reflection,
    height: int,
    reflectance: Reflectance | None = None,
    turn: Tensor | None = None,
) -> Seen:
    """What a photograph (3, H, W) shows in a mirror ball, divided by its reflectance.

    usable  (H, W) bool; of those the pixels wholly inside the silhouette are looked at
    turn    (3, 3): a direction d in the camera's frame is R d in the map's; None where they are the same
    Texels are area means of bilinear lookups.
    """
    matrix = torch.eye(3, dtype=torch.float32) if turn is None else turn.float()
    shown = usable & inside(reflection.ball).to(usable.device)
    rows, columns = (_span(shown.any(axis)) for axis in (1, 0))
    texels = _Texels.of(image[:, rows, columns], shown[rows, columns], (columns.start, rows.start))

    def radiance_of(directions: Tensor) -> Tensor:
        g, normals = reflection.normals(directions @ matrix.to(directions))
        found = texels.at(reflection.places(normals))
        if reflectance is not None:
            share = reflectance(torch.nan_to_num(reflection.incidence(g)))
            found = torch.cat([found[..., :3] / share, found[..., 3:]], dim=-1)
        return found

    parts = max(_LOOKUPS, ceil(_LOOKUPS * reflection.rows / height))
    seen = _seen(area_mean(_in_chunks(radiance_of), height, 2 * height, parts, image.device))
    y, x = (place.float() for place in torch.meshgrid(torch.arange(height), torch.arange(2 * height), indexing="ij"))
    g, _ = reflection.normals(directions_at(x, y, height, 2 * height) @ matrix)
    return Seen(seen.radiance, seen.weight * reflection.sharpness(g).to(image.device))


def surroundings(image: Tensor, usable: Tensor, ball: Ball, height: int, turn: Tensor | None = None) -> Seen:
    """What the same photograph shows directly, beside the ball; for light that is far away the same as from its place.

    turn  as for `reflected`
    The weight is 1 where anything is seen.
    """
    matrix = torch.eye(3, dtype=torch.float32) if turn is None else turn.float()
    camera = ball.camera
    beside = usable & ~touched(ball, _MARGIN).to(usable.device)
    pitch = max(1, floor(camera.focal * pi / (height - 1) / _LOOKUPS))
    texels = _Texels.of(image, beside, (0, 0), pitch)
    corners = camera.rays(torch.cartesian_prod(*(torch.tensor([0, n]) for n in camera.size[::-1])).float())
    shown = corners[:, 2].max()

    def radiance_of(directions: Tensor) -> Tensor:
        directions = directions @ matrix.to(directions)
        found = directions.new_zeros(*directions.shape[:-1], 4)
        before = directions[..., 2] <= shown
        found[before] = texels.at(camera.project(directions[before]))
        return found

    return _seen(area_mean(_in_chunks(radiance_of), height, 2 * height, _LOOKUPS, image.device))


def _in_chunks(radiance_of: Callable[[Tensor], Tensor]) -> Callable[[Tensor], Tensor]:
    """The same function (..., 3) -> (..., 4), of so many directions at a time that they stay in cache."""

    def of_all(directions: Tensor) -> Tensor:
        flat = directions.reshape(-1, 3)
        chunks = flat.split(len(flat) if flat.is_cuda else CPU_CHUNK)
        return torch.cat([radiance_of(chunk) for chunk in chunks]).reshape(*directions.shape[:-1], 4)

    return of_all


@dataclass(frozen=True)
class _Texels:
    """Pixels to look up, weighted.

    values         (rows * columns, 4): radiance times weight, and weight
    corner, pitch  x and y of the first pixel's corner, and the pixels' side, in pixels of the photograph
    """

    values: Tensor
    size: tuple[int, int]
    corner: tuple[int, int]
    pitch: int

    @classmethod
    def of(cls, image: Tensor, usable: Tensor, corner: tuple[int, int], pitch: int = 1) -> _Texels:
        """Of (3, H, W) and (H, W) bool, averaged over squares of `pitch` pixels."""
        values = torch.cat([torch.where(usable, image, 0.0), usable[None].to(image.dtype)])
        if pitch > 1:
            values = avg_pool2d(values, pitch, ceil_mode=True, count_include_pad=False)
        height, width = values.shape[1:]
        return cls(values.reshape(4, -1).t().contiguous(), (height, width), corner, pitch)

    def at(self, places: Tensor) -> Tensor:
        """(..., 4): bilinear at places (..., 2) of the photograph; 0 beyond the pixels' middles, and for NaN."""
        height, width = self.size
        x, y = (places - places.new_tensor(self.corner)).div(self.pitch).sub(0.5).unbind(-1)
        within = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        x, y = torch.where(within, x, 0.0), torch.where(within, y, 0.0)
        column, row = x.floor().clamp(0, max(0, width - 2)), y.floor().clamp(0, max(0, height - 2))
        s, t = (x - column)[..., None], (y - row)[..., None]
        first = row.long() * width + column.long()
        right, below = int(width > 1), width * int(height > 1)
        upper = torch.lerp(self.values[first], self.values[first + right], s)
        lower = torch.lerp(self.values[first + below], self.values[first + below + right], s)
        return torch.lerp(upper, lower, t) * within[..., None]


def _seen(means: Tensor) -> Seen:
    """From means (4, H, 2 H) of weighted radiance and of weights."""
    known = means[3] >= _LEAST_SEEN
    return Seen(torch.where(known, means[:3] / means[3].clamp_min(_LEAST_SEEN), 0.0), known.float())


def _span(flags: Tensor) -> slice:
    """From the first to the last that is set; all where none is."""
    found = flags.nonzero().ravel()
    return slice(int(found[0]), int(found[-1]) + 1) if len(found) else slice(0, len(flags))
