"""Basis images by precomputed transport: a new light probe costs a Fourier transform and some matrix products.

The radiance on a ring of equal polar angles of the normal, of an orthographic camera's view or of a ball's in
perspective, is a convolution over azimuth of the light with the ring's kernel. `_kernels` holds the kernels,
compressed, once per library; `light` brings a probe into their terms; `ring_lookup` averages the rings over the pixels
of a view.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from math import pi
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from torchbrdf.lasting import LastFew, lasting, on_disk
from torchbrdf.transport.harmonic._kernels import Kernels
from torchbrdf.transport.harmonic._polar_grid import PolarGrid
from torchbrdf.transport.harmonic.grid import settings, zones
from torchbrdf.transport.harmonic.light import LightHarmonics
from torchbrdf.transport.harmonic.ring_lookup import RingLookup, lookup_settings
from torchbrdf.transport.harmonic.views import in_perspective, recurs
from torchbrdf.view import View

_BRIEF = 128
"""Frequencies or values up to which one product takes less time than four of a quarter of the places and their sums."""

_UNSEEN = 1e-9
"""Share of a light's energy that is left out."""


@dataclass(frozen=True, eq=False)
class HarmonicTransport:
    """The light-independent side of the basis images of one library.

    groups  of rings, of all zones
    added   to them by perspective; empty where no view needs that
    """

    groups: tuple[Kernels, ...]
    added: tuple[Kernels, ...] = ()
    _lookups: LastFew[str, RingLookup] = field(default_factory=lambda: LastFew(4), repr=False)

    def __deepcopy__(self, memo: dict[int, Any]) -> "HarmonicTransport":
        """The same: kernels are of a mapped file, and not to be written to."""
        return self

    def __repr__(self) -> str:
        """Size."""
        added = f" and {len(self.added)} of perspective" if self.added else ""
        return f"HarmonicTransport(n = {len(self.groups[0].mixing)}, {len(self.groups)} groups of rings{added})"

    @lasting
    def lookup(self, view: View) -> RingLookup:
        """How the pixels of a view that is `facing` the shape see the rings; remembered for the last few views."""
        return self._lookups.get_or_make(view.fingerprint, lambda: self._lookup_of(view))

    def _lookup_of(self, view: View) -> RingLookup:
        all_zones = zones()
        shapes = []
        for group in self._groups_of(view):
            zone = all_zones[group.zone]
            rings = range(group.first_ring, group.first_ring + group.n_rings)
            shapes.append((group.order, zone, rings, group.places))
        if not recurs(view):
            return RingLookup.build(view, shapes).to(self.device)
        of_shapes = [[order, zone.index, rings.start, len(rings), places] for order, zone, rings, places in shapes]
        depends = [view.fingerprint, of_shapes, settings(), lookup_settings()]
        kept = on_disk("views", depends, lambda: RingLookup.build(view, shapes).tensors)
        return RingLookup.from_tensors(kept).to(self.device)

    def _groups_of(self, view: View) -> tuple[Kernels, ...]:
        return self.groups + self.added if in_perspective(view) else self.groups

    @property
    def device(self) -> torch.device:
        """Where the kernels are."""
        return self.groups[0].mixing.device

    def packed(self, light: LightHarmonics, view: View, columns: Tensor | None = None) -> Tensor:
        """(n, 3, P) float32: basis images under a light, differentiable in it.

        columns  (n,)  of the library, in order; None for all
        """
        n = self.groups[0].mixing.shape[0] if columns is None else len(columns)
        image = torch.zeros(n, 3 * len(view.pixels), dtype=torch.float32, device=self.device)
        for group, pixels, mixtures in self._seen(light, view):
            mixing = group.mixing if columns is None else group.mixing[columns]
            image[:, 3 * pixels.start : 3 * pixels.stop].addmm_(mixing, mixtures.T)
        return self._in_place(image, view)

    def blended(self, light: LightHarmonics, view: View, weights: Tensor) -> Tensor:
        """(C, 3 K, P) float32: images of C combinations of the library's columns, for weights (n, C), under K lights.

        light  of one probe, or of K at once
        They are combined before anything is done for pixels: a fraction of the cost of `packed`.
        """
        blend, channels = weights.to(self.device, torch.float32), _channels(light[0][0])
        image = torch.zeros(weights.shape[1], channels * len(view.pixels), dtype=torch.float32, device=self.device)
        for _, pixels, blends in self._seen(light, view, blend):
            image[:, channels * pixels.start : channels * pixels.stop] += blends.T
        return self._in_place(image, view)

    def coloured(self, light: LightHarmonics, view: View, weights: Tensor) -> Tensor:
        """(K, 3, P) float32: `blended` of weights (n, 3), each combination in its own channel of a light only."""
        blend, channels = weights.to(self.device, torch.float32), _channels(light[0][0])
        image = torch.zeros(1, channels * len(view.pixels), dtype=torch.float32, device=self.device)
        for _, pixels, blends in self._seen(light, view, blend, own=True):
            image[0, channels * pixels.start : channels * pixels.stop] += blends[:, 0]
        return self._in_place(image, view)[0].unflatten(0, (-1, 3))

    def pictured(self, light: LightHarmonics, view: View, weights: Tensor) -> Tensor:
        """(K, 3, P) float32: K pictures with weights (K, n, 3), as `blended` has them but with no lookup of the view.

        view  of an orthographic camera
        """
        blend = weights.to(self.device, torch.float32).movedim(0, 1).flatten(1)
        all_zones = zones()
        grid = PolarGrid(all_zones, blend.shape[1], self.device)
        contained = [frequencies_of(coefficients) for coefficients, _ in light]
        for group in self.groups:
            series = spectrum(group, light[group.zone], contained[group.zone], group.mixes(blend))
            own = torch.diagonal(series.unflatten(-1, (-1, 3)), dim1=3, dim2=5)  # each in its own colour of the light
            frequency = torch.arange(len(own), dtype=own.dtype, device=own.device)
            interpolated = torch.sinc(frequency / group.places).square()
            group.release()
            rings = range(group.first_ring, group.first_ring + group.n_rings)
            grid.add(all_zones[group.zone], rings, own.permute(2, 3, 4, 0, 1).flatten(1, 2) * interpolated[:, None])
        return grid.seen_by(view).unflatten(0, (-1, 3))

    def _seen(
        self, light: LightHarmonics, view: View, blend: Tensor | None = None, own: bool = False
    ) -> Iterator[tuple[Kernels, slice, Tensor]]:
        """Every group of rings, the pixels that see it, and its mixtures there or their blends.

        They are (3 K Q, R) or (3 K Q, C), a pixel's channels one after the other; (3 K Q, 1) of own. Kernels leave
        memory after the first pass for a view, which often is the only one: to read them again takes a tenth of a pass.
        """
        contained = [frequencies_of(coefficients) for coefficients, _ in light]
        lit = [elevations_of(coefficients) for coefficients, _ in light]
        once = view.fingerprint not in self._lookups
        for group, seen in zip(self._groups_of(view), self.lookup(view).groups, strict=True):
            if seen is None or not group.sees(lit[group.zone]):
                continue
            mixes = None if blend is None else group.mixes(blend)
            rings = _rings(group, spectrum(group, light[group.zone], contained[group.zone], mixes, own))
            mixtures = embedding_bag(seen.places, rings, seen.offsets, mode="sum", per_sample_weights=seen.weights)
            yield group, seen.pixels, mixtures.view(_channels(light[0][0]) * len(mixtures), -1)
            if once:
                group.release()

    def _in_place(self, image: Tensor, view: View) -> Tensor:
        """(C, 3 K P), pixels in order of their normals -> (C, 3 K, P) in the view's order."""
        rank = self.lookup(view).rank
        by_channel = image.view(len(image), len(rank), -1).transpose(1, 2)
        return by_channel.gather(2, rank.expand_as(by_channel))


def frequencies_of(light: Tensor) -> int:
    """How many azimuth frequencies (M, 6, elevations) hold all of the light but 1 / 30,000 of its amplitude.

    All of them where gradients are wanted: they tell what the others would change.
    """
    return len(light) if light.requires_grad else frequencies_holding(power_of(light).sum((1, 2)))


def power_of(light: Tensor) -> Tensor:
    """Squares of values, relative to the largest: none overflows."""
    return (light / light.abs().amax().clamp_min(torch.finfo(light.dtype).tiny)).square()


def frequencies_holding(energy: Tensor, lost: float = _UNSEEN) -> int:
    """How many of the first (M,) hold all but a share of an energy."""
    above = energy.flip(0).cumsum(0).flip(0) > lost * energy.sum()
    return max(1, int(above.sum()))


def elevations_of(light: Tensor) -> range:
    """The elevations of a light (M, 6, elevations) with all of it but as little as `frequencies_of` leaves out."""
    if light.requires_grad:
        return range(light.shape[2])
    energy = power_of(light).sum((0, 1))
    least = _UNSEEN * energy.sum()
    below, above = (int((side.cumsum(0) <= least).sum()) for side in (energy, energy.flip(0)))
    return range(below, len(energy) - above)


def spectrum(
    group: Kernels,
    light: tuple[Tensor, Tensor],
    contained: int,
    mixes: Sequence[tuple[Tensor, Tensor]] | None = None,
    own: bool = False,
) -> Tensor:
    """(M, 2, G, 3 K, R) or (M, 2, G, 3 K, C): series of the mixtures' radiance along the rings, or of blends of them.

    2 for real and imaginary parts, 3 K for the channels of the light
    contained  frequencies of the light; M is at most that
    mixes      of every band, to blends instead of mixtures: (r, C) for the even and (s, C) for the odd part
    own        of three blends each in its own channel of a light, C = 1
    """
    mixes = mixes or [(band.mix_even, band.mix_odd) for band in group.bands]
    parts, channels = [], _channels(light[0])
    for band, mix in zip(group.bands, mixes, strict=True):
        if band.low >= contained:
            break
        count = min(len(band.even), contained - band.low)
        frequencies = slice(band.low, band.low + count)
        rows = slice(group.first_row, group.first_row + band.even.shape[1])
        even, odd = (
            torch.bmm(side[frequencies, :, rows], kernels[:count]).view(2 * count, channels, group.n_rings, len(part))
            for side, kernels, part in zip(light, (band.even, band.odd), mix, strict=True)
        )
        if own:
            blends = _in_own_channel(even, mix[0]) + _in_own_channel(odd, mix[1])
        else:
            blends = (even.flatten(0, 2) @ mix[0]).addmm_(odd.flatten(0, 2), mix[1]).view(*even.shape[:3], -1)
        parts.append(blends.transpose(1, 2))
    series = torch.cat(parts)
    return series.unflatten(0, (-1, 2))


def _in_own_channel(mixtures: Tensor, mix: Tensor) -> Tensor:
    """(M, 3 K, G, 1): mixtures (M, 3 K, G, r) times (r, 3), channels of a light each with a column of its own."""
    of_lights = mixtures.unflatten(1, (-1, 3))
    return torch.stack([of_lights[:, :, c] @ mix[:, c] for c in range(3)], 2).flatten(1, 2)[..., None]


def _channels(coefficients: Tensor) -> int:
    """3 K of coefficients (M, 6 K, elevations)."""
    return coefficients.shape[1] // 2


def _rings(group: Kernels, series: Tensor) -> Tensor:
    """(A G, 3 K R): radiance of the mixtures at the places along the rings; rings after the place, mixtures last."""
    values, device = series[0, 0].numel(), str(series.device)
    if min(len(series), values) <= _BRIEF:
        along = _whole_series(len(series), group.places, device) @ series.reshape(-1, values)
        return along.view(-1, series[0, 0, 0].numel())
    real, imaginary = series.flatten(2).unbind(1)
    waves = _quarter_series(len(series), group.places, device)
    terms = (real[::2], real[1::2], imaginary[::2], imaginary[1::2])
    e, d, s, u = (matrix @ term for matrix, term in zip(waves, terms, strict=True))
    p, q, r, t = e + d, s + u, e.sub_(d), s.sub_(u)  # in place: memory takes as long as the products
    return torch.cat([p + q, p.sub_(q), r + t, r.sub_(t)]).view(-1, series[0, 0, 0].numel())


@lru_cache(maxsize=64)
@lasting
def _quarter_series(n_frequencies: int, places: int, device: str) -> tuple[Tensor, ...]:
    """(A / 4, M / 2) each: cosines of even and of odd frequencies, then minus the sines, at a quarter of the places.

    The other three quarters of the circle mirror the first (`ring_lookup.place_of`).
    """
    angle = (torch.arange(places // 4, dtype=torch.float64)[:, None] + 0.5) * (2 * pi / places)
    frequency = torch.arange(n_frequencies)
    twice = torch.where(frequency == 0, 1.0, 2.0)
    waves = (torch.cos(angle * frequency) * twice, -torch.sin(angle * frequency) * twice)
    return tuple(wave[:, start::2].float().contiguous().to(device) for wave in waves for start in range(2))


@lru_cache(maxsize=64)
@lasting
def _whole_series(n_frequencies: int, places: int, device: str) -> Tensor:
    """(A, 2 M): those of `_quarter_series` at all places, real and imaginary parts in turn."""
    c_even, c_odd, s_even, s_odd = _quarter_series(n_frequencies, places, device)
    waves = c_even.new_empty(4, len(c_even), n_frequencies, 2)
    for quarter, (odd, sine) in enumerate(((1, 1), (1, -1), (-1, 1), (-1, -1))):
        for start, cosines, sines, sign in ((0, c_even, s_even, 1), (1, c_odd, s_odd, odd)):
            waves[quarter, :, start::2, 0] = cosines * sign
            waves[quarter, :, start::2, 1] = sines * sign * sine
    return waves.view(places, -1)
