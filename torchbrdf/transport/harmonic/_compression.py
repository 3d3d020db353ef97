"""The light-independent side of the harmonic transport: kernels of a library's BRDFs, compressed.

For a ring of normals the radiance is a convolution over azimuth of the light with the kernel K(gamma, beta, delta)
of `grid`, whose series are of `_integrals`. Those of all columns would take a hundred times as long as those of the few
mixtures that suffice for a group of rings. Which do is told by the cells that some places across the rings meet, then
by what light makes of them at these places, and at last by the series themselves.

Columns are brought to comparable size by `column_norms`; what may be lost of them is shared among groups by their
area in the image, so that no part of it is worse than others.
"""

from collections.abc import Sequence
from itertools import pairwise
from math import pi

import torch
from torch import Tensor

from torchbrdf.brdf import StoredColumns, lower_gram, norm_settings
from torchbrdf.transport.harmonic._integrals import GroupIntegrals, Mixtures, integral_settings, perspective_terms
from torchbrdf.transport.harmonic._kernels import Band, Kernels
from torchbrdf.transport.harmonic.grid import HELD_DISTANCE, Zone
from torchbrdf.transport.harmonic.splines import SUPPORT

TOLERANCE = 2e-2
"""Relative error of a column that may be lost by compression, whatever the size of the light sources."""

_LOOSER = 1.5
"""Times the tolerance for what perspective adds, of which a view from twice `HELD_DISTANCE` sees half."""

_EARLIER, _EARLIER_ADDED = 0.3, 0.6
"""Times what may be lost at last, for what is lost before; of what perspective adds, too."""

BANDS = (0, 16, 48, 128)
"""Azimuth frequencies at which the mixtures change."""

_TRIM = 16
"""Frequencies that are dropped at a time, from the highest."""

TEXEL_ROWS = 256
"""Rows of the finest probe that is resolved."""

_PILOT = 9
"""Of so many places across a group's rings one tells which mixtures suffice."""

_GRAM_CELLS = 1 << 14
"""Cells of MERL's grid that tell mixtures, about."""

_MIXTURES = 128
"""Mixtures, at most, that these tell apart."""


def compute_group(
    stored: StoredColumns, orders: Sequence[int], zone: Zone, rings: range, norms: Tensor, n_zones: int
) -> tuple[Kernels, ...]:
    """The kernels of one group of rings, or what perspective adds to them; without mixtures where that is nothing.

    orders   (0,) of an orthographic camera, (1, 2) of perspective: one result for each
    norms    (n,)  of `column_norms`
    n_zones  among which the tolerance is shared, and among groups by their area in the image
    """
    return _Group(stored, orders, zone, rings, norms, n_zones).kernels()


def kernel_settings() -> list[object]:
    """What the kernels depend on beside the library and the grid."""
    earlier = [_EARLIER, _PILOT, _GRAM_CELLS, _MIXTURES]
    return [TOLERANCE, BANDS, _TRIM, TEXEL_ROWS, *earlier, *integral_settings(), *norm_settings()]


def perspective_settings() -> list[object]:
    """What the kernels that perspective adds depend on beside those."""
    return [HELD_DISTANCE, _LOOSER, _EARLIER_ADDED, perspective_terms()]


class _Group:
    def __init__(
        self, stored: StoredColumns, orders: Sequence[int], zone: Zone, rings: range, norms: Tensor, n_zones: int
    ) -> None:
        self.orders, self.zone, self.rings, self.norms = orders, zone, rings, norms
        self.integrals = GroupIntegrals(stored, orders, zone, rings)
        self.ring_measure = zone.ring_measure[rings.start : rings.stop]
        self.rows = slice(self.integrals.first_row, self.integrals.first_row + self.integrals.n_rows)
        added = 0 not in orders
        share = float(self.ring_measure.sum() / zone.ring_measure.sum()) / (n_zones * 2 * len(BANDS))
        self.allowance = TOLERANCE * (_LOOSER if added else 1) * share**0.5
        self.earlier = self.allowance * (_EARLIER_ADDED if added else _EARLIER)

    def kernels(self) -> tuple[Kernels, ...]:
        mixtures = self._mixtures()
        normalised = Mixtures(mixtures.loadings / self.norms[:, None], mixtures.r)
        return tuple(
            self._compressed(order, mixtures, parts)
            for order, parts in zip(self.orders, self.integrals.spectra(normalised), strict=True)
        )

    def _mixtures(self) -> Mixtures:
        """Of the normalised columns, those that suffice at a few places across the rings."""
        n_places = self.integrals.n_places
        seen = self.integrals.cells(torch.arange(min(_PILOT, n_places) // 2, n_places, _PILOT))
        measure = self.ring_measure.sum() / len(seen.places)
        step = max(1, 2 * len(seen.cells) // _GRAM_CELLS)
        power = self.integrals.power(seen)[::step] * (measure * step)
        gram = self.integrals.gram(seen.cells[::step], power) / self.norms / self.norms[:, None]
        size, vectors = _principal(gram)
        vectors = vectors[:, : min(max(1, _needed(vectors, size, self.earlier)), _MIXTURES)]
        r = vectors.shape[1]
        grams = torch.zeros(2, r, r, dtype=torch.float64)
        scale = (measure / self.zone.row_measure[self.rows]).sqrt().repeat_interleave(self.integrals.line)
        both = Mixtures((vectors / self.norms[:, None]).repeat(1, 2), r)
        for _, spread in self.integrals.spread(seen, both):
            for nodes in spread.flatten(0, 1):
                reached = nodes.any(1)  # a half or less
                weighted = nodes[reached].double() * scale[reached, None]
                for found, part in zip(grams, both.parts(weighted, 1), strict=True):
                    found += part.T @ part
        kept = []
        for found, least in zip(grams * (self.integrals.per_delta / 2), (1, 0), strict=True):
            size, mixed = _principal(found)
            loadings = vectors @ mixed
            kept.append(loadings[:, : max(least, _needed(loadings, size, self.earlier))])
        return Mixtures(torch.cat(kept, 1), kept[0].shape[1])

    def _compressed(self, order: int, mixtures: Mixtures, parts: tuple[Tensor, Tensor]) -> Kernels:
        """From real and imaginary parts of spectra (G, E, r or s, M)."""
        loadings, scale = mixtures.parts(mixtures.loadings, 1), self._scale()

        def components(low: int, high: int) -> list[tuple[Tensor, Tensor]]:
            """Sizes (q,) and mixtures (r, q) that a band of real, then of imaginary parts needs."""
            found = []
            for part, loading in zip(parts, loadings, strict=True):
                block = (part[..., low:high] * scale[..., low:high]).transpose(0, 2).flatten(1).double()
                size, vectors = _principal(lower_gram(block) / pi)
                needed = _needed(loading @ vectors, size, self.allowance)
                found.append((size[:needed], vectors[:, :needed]))
            return found

        end = self.zone.frequencies
        while end > _TRIM and not any(len(size) for size, _ in components(end - _TRIM, end)):
            end -= _TRIM
        edges = list(pairwise(sorted({min(edge, end) for edge in (*BANDS, end)})))
        places = 4 * (end // 2 + 1)
        interpolated = torch.sinc(torch.arange(end, dtype=torch.float32) / places).square()
        mixes = []
        total = torch.zeros(len(self.norms), len(self.norms), dtype=torch.float64)
        for low, high in edges:
            found = components(low, high)
            mixes.append([vectors for _, vectors in found])
            for (size, vectors), loading in zip(found, loadings, strict=True):
                mixed = loading @ vectors
                total += (mixed * size) @ mixed.T
        size, basis = _principal(total)
        basis = basis[:, : max(0 if order else 1, _needed(basis, size, self.allowance))]
        bands = []
        for (low, high), mix in zip(edges, mixes, strict=True):
            even, odd = (
                _reduced(part[..., low:high], vectors).div_(interpolated[low:high, None, None])
                for part, vectors in zip(parts, mix, strict=True)
            )
            to_basis = ((loading @ vectors).T @ basis for loading, vectors in zip(loadings, mix, strict=True))
            bands.append(Band(low, even, odd, *(matrix.float() for matrix in to_basis)))
        mixing = (self.norms[:, None] * basis).float()
        return Kernels(
            order, self.zone.index, self.rings.start, len(self.rings), places, self.rows.start, mixing, tuple(bands)
        )

    def _scale(self) -> Tensor:
        """(G, E, 1, M): what makes the sum of squares of moments the kernels' square integral, times pi.

        Light counts as far as a probe of TEXEL_ROWS rows can hold it: bilinear between its texels.
        """
        zone = self.zone
        measure = self.ring_measure[:, None] * zone.row_measure[self.rows]
        middle = torch.arange(zone.elevations, dtype=torch.float64)[self.rows] - 1
        from_pole = (torch.minimum(middle, zone.rows - middle).clamp_min(0) + SUPPORT / 2) * (pi / zone.rows)
        sine = torch.sin(from_pole.clamp_max(pi / 2))
        slowness = torch.arange(zone.frequencies) / (2 * TEXEL_ROWS * sine[:, None])
        texels = 1 / (1 + (pi * slowness).square())  # the envelope of a hat's transform
        return (measure.rsqrt()[..., None] * texels).float()[:, :, None]


def _reduced(part: Tensor, vectors: Tensor) -> Tensor:
    """Spectra (G, E, r, M) of mixtures, mixed by (r, q): (M, E, G q)."""
    return torch.einsum("germ,rq->megq", part, vectors.float()).flatten(2).contiguous()


def _principal(gram: Tensor) -> tuple[Tensor, Tensor]:
    """Eigenvalues, from the largest, and eigenvectors, of the lower triangle."""
    size, vectors = torch.linalg.eigh(gram)
    return size.flip(0).clamp_min(0), vectors.flip(1)


def _needed(loadings: Tensor, size: Tensor, allowance: float) -> int:
    """How many of the components (n, r) of size (r,) leave 95 % of the columns within an allowance, all within four."""
    if not len(size):
        return 0
    left = (loadings.square() * size).flip(1).cumsum(1).flip(1).sqrt()  # what components i, i + 1, ... hold
    most = torch.maximum(left.quantile(0.95, dim=0), left.amax(0) / 4)
    return int((most > allowance).sum())
