"""From rings of normals to the pixels of a view: averages over each pixel's area of the reflectance map.

A view of an orthographic camera sees the same radiance wherever it sees the same normal. Here its pixels become sums
over places on the rings of `harmonic_grid`: splines across the rings, linear interpolation along them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
import torch
from torch import Tensor

from torchbrdf.harmonic_grid import Zone
from torchbrdf.splines import SUPPORT, spline_weights
from torchbrdf.view import View

_POINTS = 10
"""Gauss points along a side of a pixel."""

_CHUNK = 512
_ORTHOGRAPHIC = 1e-6


@dataclass(frozen=True)
class GroupLookup:
    """Sums over the places of one group of rings, for the pixels start, ..., start + Q - 1 in order of their normals.

    places   (N,) int32: of channel c and ring g of G, (3 a + c) G + g, with a of `place_of`
    offsets  (3 Q,) int32: where the places of each pixel's channels start
    weights  (N,) float32
    """

    start: int
    places: Tensor
    offsets: Tensor
    weights: Tensor

    @property
    def pixels(self) -> slice:
        """The pixels that see the group."""
        return slice(self.start, self.start + len(self.offsets) // 3)


@dataclass(frozen=True)
class RingLookup:
    """order (P,) int64: pixels of the view by polar angle of their normals; groups None where no pixel sees them."""

    order: Tensor
    groups: tuple[GroupLookup | None, ...]

    @staticmethod
    def build(view: View, groups: Sequence[tuple[Zone, range, int]]) -> "RingLookup":
        """For groups given by zone, rings and places along a ring. The view must not be `unsuited`."""
        gamma, alpha, share = _normals(view)
        order = torch.argsort(gamma.mean(1))
        gamma, alpha = gamma[order], alpha[order]
        found = []
        of_zone: dict[int, tuple[Tensor, Tensor]] = {}
        for zone, rings, places in groups:
            if zone.index not in of_zone:
                x = zone.ring_coordinate(gamma).clamp_max(zone.intervals - 1e-9)
                of_zone[zone.index] = (x.floor().long(), spline_weights(x) * share[:, None])
            found.append(_group(*of_zone[zone.index], zone.ring_dual[:, rings.start : rings.stop], alpha, places))
        return RingLookup(order, tuple(found))

    def to(self, device: torch.device | str) -> "RingLookup":
        """On another device."""
        groups = [
            g and GroupLookup(g.start, g.places.to(device), g.offsets.to(device), g.weights.to(device))
            for g in self.groups
        ]
        return RingLookup(self.order.to(device), tuple(groups))


def unsuited(view: View) -> str | None:
    """Why the harmonic transport cannot render a view; None where it can."""
    if type(view).visibility is not View.visibility:
        return f"{view!r} may shade itself"
    toward = view.view_dirs[:, view.mask[0]]
    if not bool((toward[2] > 1 - _ORTHOGRAPHIC).all()):
        return f"the camera of {view!r} is not orthographic along -Z"
    return None


def place_of(azimuth: Tensor, places: int) -> Tensor:
    """Where the azimuth (n + 1/2) 2 pi / A stands among the A places of a ring.

    Its quarters hold the angles t of the first quadrant, then -t, pi + t and pi - t.
    """
    quarter = places // 4
    mirrored = torch.where(azimuth % (2 * quarter) < quarter, azimuth % quarter, quarter - 1 - azimuth % quarter)
    block = torch.tensor([0, 3, 2, 1])[azimuth // quarter]
    return block * quarter + mirrored


def _normals(view: View) -> tuple[Tensor, Tensor, Tensor]:
    """Polar angle and azimuth (P, S) float64 of normals inside the pixels, and the points' shares (S,)."""
    node, share = np.polynomial.legendre.leggauss(_POINTS)
    at = torch.tensor((node + 1) / 2, dtype=torch.float32)
    v, u = (axis.reshape(1, -1).expand(len(view.pixels), -1) for axis in torch.meshgrid(at, at, indexing="ij"))
    x, y, z = view.surface(view.pixels.cpu(), u, v).normals.double()
    weights = torch.tensor(np.outer(share, share).ravel() / 4)
    return torch.atan2(torch.hypot(x, y), z).clamp(0, pi / 2), torch.atan2(y, x), weights


def _group(first: Tensor, across: Tensor, dual: Tensor, alpha: Tensor, places: int) -> GroupLookup | None:
    """One group, from each point's first spline (P, S) and its four values (P, S, 4).

    dual  (rings, G): the group's columns
    """
    touched = torch.nonzero((dual != 0).any(1)).ravel()
    near = (first <= touched[-1]) & (first + SUPPORT > touched[0])
    pixels = torch.nonzero(near.any(1)).ravel()
    n_rings = dual.shape[1]
    rows: list[Tensor] = []
    columns: list[Tensor] = []
    values: list[Tensor] = []
    for some in pixels.split(_CHUNK):
        index = first[some][..., None] + torch.arange(SUPPORT)
        by_ring = torch.einsum("psk,pskg->psg", across[some], dual[index])
        position = torch.remainder(alpha[some] * (places / (2 * pi)) - 0.5, places)
        low = position.floor()
        part = (position - low)[..., None]
        total = torch.zeros(len(some) * places, n_rings, dtype=torch.float64)
        for step, share in ((0, 1 - part), (1, part)):
            azimuth = (low.long() + step) % places
            at = torch.arange(len(some))[:, None] * places + place_of(azimuth, places)
            total.index_add_(0, at.ravel(), (by_ring * share).flatten(0, 1))
        total = total.view(len(some), places * n_rings)
        row, column = torch.nonzero(total, as_tuple=True)
        for found, more in ((rows, some[row]), (columns, column), (values, total[row, column])):
            found.append(more)
    if not rows or not len(torch.cat(rows)):
        return None
    row, place, value = torch.cat(rows), torch.cat(columns), torch.cat(values).float()
    start, stop = int(row[0]), int(row[-1]) + 1
    azimuth, ring = place // n_rings, place % n_rings
    channels = torch.arange(3)[:, None]
    bag = 3 * (row - start) + channels
    order = torch.argsort(bag.ravel(), stable=True)
    all_places = ((3 * azimuth + channels) * n_rings + ring).ravel()[order]
    offsets = torch.searchsorted(bag.ravel()[order], torch.arange(3 * (stop - start)))
    return GroupLookup(start, all_places.int(), offsets.int(), value.repeat(3)[order])
