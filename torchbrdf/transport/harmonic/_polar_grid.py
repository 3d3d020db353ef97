"""Radiance on a polar grid of normals, and from there to the pixels of a view, with nothing prepared for the view."""

from collections.abc import Hashable, Sequence
from functools import lru_cache
from math import pi

import torch
from torch import Tensor

from torchbrdf.lasting import LastFew, lasting
from torchbrdf.transport.harmonic._bilinear import bilinear
from torchbrdf.transport.harmonic.grid import Zone
from torchbrdf.transport.harmonic.splines import SUPPORT, banded_product
from torchbrdf.transport.harmonic.views import in_perspective, surface_inside, widths_of
from torchbrdf.view import View

_PER_INTERVAL = 2
"""Rows between two rings of the finest zone."""

_PLACES = 4
"""Places along a row for each of the highest frequency."""

_SPACING = 1 / 3
"""Between points inside a pixel, of normals half way to the mirrored direction on the disc of a sphere of radius 1, in
the finest zone's rows of light."""

_POINTS = (2, 4, 6, 8, 12, 16, 24)
"""Points along a side of a pixel that are used."""

_POINTS_AT_ONCE = 1 << 18
"""Inside pixels: 20 MB of the pictures of six tables."""

_POINTS_SEEN = LastFew[Hashable, list[tuple[Tensor, Tensor, Tensor]]](2)
"""Of views, ten MB each."""


class PolarGrid:
    """Fourier series over azimuth of C pictures, summed over zones.

    The grid's rows are polar angles of normals, half way between +Z and the mirror direction as on the rings of `grid`.
    """

    def __init__(self, zones: Sequence[Zone], pictures: int, device: torch.device) -> None:
        """Dark, as fine as the finest of the zones."""
        self._finest = max(zones, key=lambda zone: zone.rows)
        rows = _PER_INTERVAL * self._finest.intervals + 1
        self._series = torch.zeros(rows, pictures, self._finest.frequencies, 2, dtype=torch.float32, device=device)

    def add(self, zone: Zone, rings: range, series: Tensor) -> None:
        """Add (G, C, M, 2), real and imaginary parts on a group of rings, as moments over the image."""
        to_rows = _rings_to_rows(self._finest, zone)[:, rings.start : rings.stop]
        touched = torch.nonzero((to_rows != 0).any(1)).ravel()
        rows = slice(int(touched[0]), int(touched[-1]) + 1)
        found = (to_rows[rows].to(series) @ series.flatten(1)).view(-1, *series.shape[1:])
        self._series[rows, :, : series.shape[2]] += found

    def add_values(self, zone: Zone, series: Tensor) -> None:
        """Add (Q, C, M, 2), real and imaginary parts at the places of the zone's `ring_quadrature`."""
        to_rows = _values_to_rows(self._finest, zone).to(series)
        found = banded_product(to_rows, series.flatten(1)).view(-1, *series.shape[1:])
        self._series[:, :, : series.shape[2]] += found

    def seen_by(self, view: View) -> Tensor:
        """(C, P): averages over the area of each pixel of a view that is `facing` the shape."""
        radiance = self._radiance()
        packed = radiance.new_zeros(len(radiance), len(view.pixels))
        key = (view.fingerprint, self._finest, radiance.shape[1:])
        for some, places, share in _POINTS_SEEN.get_or_make(key, lambda: self._points(view, radiance.shape)):
            seen = bilinear(radiance, places.to(radiance))
            packed[:, some.to(packed.device)] = torch.einsum("cqs,qs->cq", seen, share.to(radiance))
        return packed

    def _radiance(self) -> Tensor:
        """(C, H, A + 1), the first of A azimuths repeated at the end; a picture at a time, for the memory."""
        rows, pictures, frequencies = self._series.shape[:3]
        places = _PLACES * (frequencies - 1)
        frequency = torch.arange(frequencies, dtype=torch.float32, device=self._series.device)
        between = torch.sinc(frequency / places).square()
        radiance = self._series.new_empty(pictures, rows, places + 1)
        for i in range(pictures):
            waves = torch.view_as_complex(self._series[:, i]) / between  # what interpolation between places costs
            radiance[i, :, :-1] = torch.fft.irfft(waves, n=places, norm="forward")
        radiance[..., -1] = radiance[..., 0]
        return radiance

    @lasting
    def _points(self, view: View, shape: torch.Size) -> list[tuple[Tensor, Tensor, Tensor]]:
        """Some of the pixels, where `bilinear` finds the points inside them, and their shares of the area."""
        pixels = view.pixels.cpu()
        points = _points_of(view, pixels, _SPACING * pi / self._finest.rows)
        found = []
        for n in points.unique().tolist():
            for some in torch.nonzero(points == n).ravel().split(max(1, _POINTS_AT_ONCE // n**2)):
                places, lit = self._places(view, pixels[some], (torch.arange(n, dtype=torch.float32) + 0.5) / n, shape)
                found.append((some, places.float(), lit.float() / n**2))  # a normal that faces away is dark
        return found

    def _places(self, view: View, pixels: Tensor, at: Tensor, shape: torch.Size) -> tuple[Tensor, Tensor]:
        """(P, n n, 2): where `grid_sample` finds the points of pixels; and which are not turned away."""
        points = surface_inside(view, pixels, at)
        (x, y, z), toward = points.normals, points.view_dirs
        gamma = torch.atan2(torch.hypot(x, y), z)
        if in_perspective(view):
            gamma = gamma + torch.atan2(torch.hypot(toward[0], toward[1]), toward[2]) / 2
        _, height, width = shape
        row = _PER_INTERVAL * self._finest.ring_coordinate(gamma.clamp(0, pi / 2)).to(gamma)
        column = torch.remainder(torch.atan2(y, x) * ((width - 1) / (2 * pi)), width - 1)
        return torch.stack([column * (2 / (width - 1)) - 1, row * (2 / (height - 1)) - 1], -1), z > 0


@lru_cache(maxsize=16)
@lasting
def _rings_to_rows(finest: Zone, zone: Zone) -> Tensor:
    """(H, rings) float32: moments over the image -> values on the rows of a grid as fine as another zone."""
    rows = torch.arange(_PER_INTERVAL * finest.intervals + 1, dtype=torch.float64) / _PER_INTERVAL
    first, weights = zone.ring_splines(finest.ring_angle(rows))
    return torch.einsum("hk,hkg->hg", weights, zone.ring_dual[first[:, None] + torch.arange(SUPPORT)]).float()


@lru_cache(maxsize=16)
@lasting
def _values_to_rows(finest: Zone, zone: Zone) -> Tensor:
    """(H, Q) float32: the same for values at the places of the zone's `ring_quadrature`."""
    return _rings_to_rows(finest, zone) @ zone.ring_quadrature[1].float()


def _points_of(view: View, pixels: Tensor, spacing: float) -> Tensor:
    """(P,) int64: how many points along a side of each pixel."""
    normals = surface_inside(view, pixels, torch.tensor([0.02, 0.5, 0.98], dtype=torch.float32)).normals
    counts = torch.tensor(_POINTS)
    return counts[torch.bucketize(widths_of(normals) / spacing, counts).clamp_max(len(counts) - 1)]
