"""From rings of normals to the pixels of a view: averages over each pixel's area of the reflectance map.

A view of an orthographic camera sees the same radiance wherever it sees the same normal. Here its pixels become sums
over places on the rings of `grid`: splines across the rings, linear interpolation along them. A ball in perspective is
looked up by the directions that it mirrors, and what perspective adds is interpolated in the tilt of the view.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
import torch
from torch import Tensor

from torchbrdf.transport.harmonic._mirror_images import MirrorImages, azimuths_of_images
from torchbrdf.transport.harmonic.grid import Zone, tilt_of
from torchbrdf.transport.harmonic.splines import SUPPORT
from torchbrdf.transport.harmonic.views import in_perspective, surface_inside, widths_of
from torchbrdf.view import View

_POINTS = (10, 16, 24)
"""Gauss points along a side of a pixel: the first for those of a sphere, more where normals vary more inside."""

_SPREAD = 0.05
"""How far apart the normals of a pixel may be on the disc of a sphere of radius 1, for the first number of points."""

_CHUNK = 256


@dataclass(frozen=True)
class GroupLookup:
    """Sums over the places of one group of rings, for Q pixels from number start on in the order of `RingLookup`.

    places   (N,) int32: a G + g of ring g of G, with a of `place_of`
    offsets  (Q,) int32: where the places of each pixel start
    weights  (N,) float32
    """

    start: int
    places: Tensor
    offsets: Tensor
    weights: Tensor

    @property
    def pixels(self) -> slice:
        """The pixels that see the group."""
        return slice(self.start, self.start + len(self.offsets))


@dataclass(frozen=True)
class RingLookup:
    """rank (P,) int64: of the view's pixels, by polar angle of normals; groups None where no pixel sees them."""

    rank: Tensor
    groups: tuple[GroupLookup | None, ...]

    @staticmethod
    def build(view: View, groups: Sequence[tuple[int, Zone, range, int]]) -> "RingLookup":
        """For groups given by order, zone, rings and places along a ring.

        view  not `unsuited`, of a camera that is `facing` the shape
        """
        images = MirrorImages.of(view)
        points = _Points.of(view, images.pixels)
        source = points.rank[images.source]
        order = torch.argsort(source, stable=True)
        copies = MirrorImages(images.pixels, source[order], images.image[order])
        shares = (points.share, points.share * points.tilt, points.share * 4 * points.tilt * (1 - points.tilt))
        found = []
        of_zone: dict[tuple[int, int], tuple[Tensor, Tensor]] = {}
        for term, zone, rings, places in groups:
            if (term, zone.index) not in of_zone:
                first, across = zone.ring_splines(points.gamma)
                of_zone[term, zone.index] = (first, across * shares[term][:, None])
            dual = zone.ring_dual[:, rings.start : rings.stop]
            found.append(_group(points, copies, *of_zone[term, zone.index], dual, places))
        return RingLookup(torch.argsort(order), tuple(found))

    @property
    def tensors(self) -> dict[str, Tensor]:
        """All of it, group after group."""
        seen = [group for group in self.groups if group is not None]
        starts = [-1 if group is None else group.start for group in self.groups]
        sizes = [[len(group.places), len(group.offsets)] for group in seen]
        joined = {
            name: torch.cat([getattr(group, name) for group in seen]) for name in ("places", "offsets", "weights")
        }
        return {"rank": self.rank, "starts": torch.tensor(starts), "sizes": torch.tensor(sizes), **joined}

    @staticmethod
    def from_tensors(tensors: dict[str, Tensor]) -> "RingLookup":
        """The inverse of `tensors`."""
        n_places, n_pixels = tensors["sizes"].T.tolist()
        parts = zip(
            tensors["places"].split(n_places),
            tensors["offsets"].split(n_pixels),
            tensors["weights"].split(n_places),
            strict=True,
        )
        starts = tensors["starts"].tolist()
        groups = [None if start < 0 else GroupLookup(start, *next(parts)) for start in starts]
        return RingLookup(tensors["rank"], tuple(groups))

    def to(self, device: torch.device | str) -> "RingLookup":
        """On another device."""
        groups = [
            g and GroupLookup(g.start, g.places.to(device), g.offsets.to(device), g.weights.to(device))
            for g in self.groups
        ]
        return RingLookup(self.rank.to(device), tuple(groups))


def lookup_settings() -> list[object]:
    """What a lookup depends on beside the view, the grid and the groups."""
    return [_POINTS, _SPREAD]


def place_of(azimuth: Tensor, places: int) -> Tensor:
    """Where the azimuth (n + 1/2) 2 pi / A, for n of any size, stands among the A places of a ring.

    Its quarters hold the angles t of the first quadrant, then -t, pi + t and pi - t.
    """
    quarter, azimuth = places // 4, azimuth % places
    mirrored = torch.where(azimuth % (2 * quarter) < quarter, azimuth % quarter, quarter - 1 - azimuth % quarter)
    block = torch.tensor([0, 3, 2, 1])[azimuth // quarter]
    return block * quarter + mirrored


@dataclass(frozen=True)
class _Points:
    """Points inside some pixels of a view, pixel by pixel.

    rank          (Q,) int64: of the pixels by polar angle of their normals
    pixel         (N,) int64: its rank
    gamma, alpha  (N,) float64: polar angle and azimuth of the normal half way between +Z and the mirror direction
    share         (N,) of the pixel's area
    tilt          (N,) of the view direction, relative to `tilt_of`
    """

    rank: Tensor
    pixel: Tensor
    gamma: Tensor
    alpha: Tensor
    share: Tensor
    tilt: Tensor

    @staticmethod
    def of(view: View, pixels: Tensor) -> "_Points":
        """More of them in pixels (Q,) whose normals vary more."""
        corners, _ = _seen_at(view, pixels, torch.tensor([0.02, 0.5, 0.98], dtype=torch.float64))
        rank = torch.argsort(torch.argsort(corners[2].mean(1), descending=True))
        tiers = [_SPREAD * n / _POINTS[0] for n in _POINTS[:-1]]
        tier = torch.bucketize(widths_of(corners), torch.tensor(tiers, dtype=torch.float32))
        parts = []
        for index, n in enumerate(_POINTS):
            node, weight = np.polynomial.legendre.leggauss(n)
            some = torch.nonzero(tier == index).ravel()
            normals, tilt = _seen_at(view, pixels[some], torch.tensor((node + 1) / 2))
            (x, y, z), tilt = normals.flatten(1), tilt.flatten()
            gamma = (torch.atan2(torch.hypot(x, y), z) + tilt / 2).clamp(0, pi / 2)
            weights = torch.tensor(np.outer(weight, weight).ravel() / 4).repeat(len(some))
            weights = torch.where(z > 0, weights, 0)  # a normal that faces away is dark
            held = tilt_of(gamma)
            relative = torch.where(held > 0, tilt / held, 0)
            parts.append((rank[some].repeat_interleave(n * n), gamma, torch.atan2(y, x), weights, relative))
        pixel, *values = (torch.cat(part) for part in zip(*parts, strict=True))
        by_pixel = torch.argsort(pixel, stable=True)
        return _Points(rank, pixel[by_pixel], *(value[by_pixel] for value in values))


def _seen_at(view: View, pixels: Tensor, at: Tensor) -> tuple[Tensor, Tensor]:
    """Normals (3, Q, n n) float64 at a grid of places inside pixels, in [0, 1) along both sides.

    And by how much (Q, n n) the view directions are tilted against +Z.
    """
    points = surface_inside(view, pixels, at)
    x, y, z = points.view_dirs.double()
    tilt = torch.atan2(torch.hypot(x, y), z) if in_perspective(view) else torch.zeros_like(z)
    return points.normals.double(), tilt


def _group(
    points: _Points, images: MirrorImages, first: Tensor, across: Tensor, dual: Tensor, places: int
) -> GroupLookup | None:
    """One group, from each point's first spline (N,) and its four values (N, 4).

    images  in order of what they are images of
    dual    (rings, G): the group's columns
    """
    touched = torch.nonzero((dual != 0).any(1)).ravel()
    near = torch.nonzero((first <= touched[-1]) & (first + SUPPORT > touched[0])).ravel()
    if not len(near):
        return None
    n_rings = dual.shape[1]
    start, stop = int(points.pixel[near[0]]), int(points.pixel[near[-1]]) + 1
    rows: list[Tensor] = []
    columns: list[Tensor] = []
    values: list[Tensor] = []
    for low_pixel in range(start, stop, _CHUNK):
        ends = torch.searchsorted(points.pixel[near], torch.tensor([low_pixel, low_pixel + _CHUNK]))
        some = near[ends[0] : ends[1]]
        by_ring = torch.einsum("nk,nkg->ng", across[some], dual[first[some, None] + torch.arange(SUPPORT)])
        position = torch.remainder(points.alpha[some] * (places / (2 * pi)) - 0.5, places)
        low = position.floor()
        part = (position - low)[:, None]
        present, index = torch.unique_consecutive(points.pixel[some], return_inverse=True)
        touches = [index * places + (low.long() + step) % places for step in range(2)]
        touched_places = torch.zeros(len(present) * places, dtype=torch.bool)
        for touch in touches:
            touched_places[touch] = True
        number = touched_places.cumsum(0) - 1  # of a place among those that points touch, which are few
        total = torch.zeros(int(number[-1]) + 1, n_rings, dtype=torch.float64)
        for touch, share in zip(touches, (1 - part, part), strict=True):
            total.index_add_(0, number[touch], by_ring * share)
        at, ring = torch.nonzero(total, as_tuple=True)
        place = torch.nonzero(touched_places).ravel()[at]
        for found, more in (
            (rows, present[place // places]), (columns, place % places * n_rings + ring), (values, total[at, ring])
        ):  # fmt: skip
            found.append(more)
    row, column, value = torch.cat(rows), torch.cat(columns), torch.cat(values).float()
    ends = torch.searchsorted(images.source, torch.tensor([start, stop]))
    seen = slice(int(ends[0]), int(ends[1]))
    image, entry, offsets = _copied(row - start, images.source[seen] - start, images.image[seen])
    turned = place_of(azimuths_of_images(places), places)
    at = turned[image, column[entry] // n_rings] * n_rings + column[entry] % n_rings
    return GroupLookup(seen.start, at.int(), offsets.int(), value[entry])


def _copied(row: Tensor, source: Tensor, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The entries of images (P,) of sources (P,), from those of the sources, by rows (N,): image, entry, offsets."""
    counts = torch.bincount(row, minlength=int(source.max()) + 1)  # a source may have none
    firsts, count = counts.cumsum(0) - counts, counts[source]
    offsets = count.cumsum(0) - count
    entry = torch.arange(int(count.sum())) + (firsts[source] - offsets).repeat_interleave(count)
    return image.repeat_interleave(count), entry, offsets
