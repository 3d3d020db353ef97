"""The light-independent side of the harmonic transport: kernels of a library's BRDFs, compressed.

For a ring of normals the radiance is a convolution over azimuth of the light with the kernel K(gamma, beta, delta)
of `grid`. Here the kernels' Fourier series in delta is integrated, for splines over gamma and beta, by
sampling half vectors: places in theta_h follow the cells of MERL's grid, so lobes as sharp as a table can hold are
integrated, not sampled. (Averages over texels of the light, by contrast, miss most of a mirror's lobe.)

A group of neighbouring rings sees nearly the same BRDFs. So each group has a basis of its own, mixtures of the
library's columns, and each band of its frequencies a smaller one, for the kernels' even and odd part apart. Columns
are brought to comparable size by `column_norms`; what may be lost of them is shared among groups by their area in the
image, so that no part of it is worse than others.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from math import pi

import torch
from torch import Tensor

from torchbrdf.brdf import StoredColumns, norm_settings
from torchbrdf.transport.harmonic._half_vectors import HalfVectors, half_vectors
from torchbrdf.transport.harmonic._pages import Pages
from torchbrdf.transport.harmonic._waves import PLACES, waves
from torchbrdf.transport.harmonic.grid import HELD_DISTANCE, Zone, tilt_of
from torchbrdf.transport.harmonic.splines import SUPPORT, spline_weights

TOLERANCE = 2e-2
"""Relative error of a column that may be lost by compression, whatever the size of the light sources."""

_LOOSER = 1.5
"""Times the tolerance for what perspective adds, of which a view from twice `HELD_DISTANCE` sees half."""

_TERMS = (((0.0, 1.0),), ((0.0, -1.0), (1.0, 1.0)), ((0.0, -0.5), (0.5, 1.0), (1.0, -0.5)))
"""Shares of `tilt_of`, with factors: kernels without tilt, and the differences that interpolate to others.

With a share t of the tilt the kernels are those of order 0, t times those of 1, and 4 t (1 - t) times those of 2.
"""

BANDS = (0, 16, 48, 128)
"""Azimuth frequencies at which the mixtures change."""

_TRIM = 16
"""Frequencies that are dropped at a time, from the highest."""

TEXEL_ROWS = 256
"""Rows of the finest probe that is resolved."""

_AZIMUTHS = (64, 96, 128, 192)
"""Half vectors on a half circle about the normal, by zone."""

_MIXTURES = 128
"""Mixtures, at most, with which a group is computed before its final, smaller basis is known."""

_GRAM_CELLS = 1 << 15
"""Cells of MERL's grid that tell a group's first mixtures, about."""

_ROWS_AT_ONCE = 1 << 14
_BLOCK = 1 << 25
"""Floats of spread samples held at once."""


@dataclass(frozen=True)
class Band:
    """Azimuth frequencies low, ..., low + M - 1 of a group's kernels: 2 pi times the conjugate series.

    even      (M, E, G r) float32: real parts, of r mixtures; rings before mixtures
    odd       (M, E, G s) float32: imaginary parts, of s other mixtures
    mix_even  (r, R) float32: what these mixtures add to those of the group
    mix_odd   (s, R)
    """

    low: int
    even: Tensor
    odd: Tensor
    mix_even: Tensor
    mix_odd: Tensor

    def to(self, device: torch.device | str) -> "Band":
        """On another device."""
        return Band(self.low, *(getattr(self, name).to(device) for name in ("even", "odd", "mix_even", "mix_odd")))


@dataclass(frozen=True)
class Kernels:
    """One group of rings of one zone.

    order       which of the terms that make a view in perspective; 0 without it
    zone        its index
    first_ring  rings first_ring, ..., first_ring + G - 1
    n_rings     G
    places      along a ring, a multiple of 4, at which the series is summed; the bands make up for what linear
                interpolation between them costs
    first_row   splines over elevation first_row, ..., first_row + E - 1
    mixing      (n, R) float32: image of column k = sum_q mixing[k, q] image of mixture q
    bands       by frequency
    pages       of the file that holds all of it, where it is mapped
    """

    order: int
    zone: int
    first_ring: int
    n_rings: int
    places: int
    first_row: int
    mixing: Tensor
    bands: tuple[Band, ...]
    pages: Pages | None = None

    def sees(self, elevations: range) -> bool:
        """Whether light from some of these elevations reaches its rings."""
        rows = range(self.first_row, self.first_row + self.bands[0].even.shape[1]) if self.bands else range(0)
        return max(rows.start, elevations.start) < min(rows.stop, elevations.stop)

    def mixes(self, blend: Tensor) -> list[tuple[Tensor, Tensor]]:
        """How combinations of the library's columns, with weights (n, C), mix every band's even and odd kernels."""
        combined = self.mixing.T @ blend
        return [(band.mix_even @ combined, band.mix_odd @ combined) for band in self.bands]

    def to(self, device: torch.device | str) -> "Kernels":
        """On another device."""
        if self.mixing.device == torch.device(device):
            return self
        bands = tuple(band.to(device) for band in self.bands)
        return replace(self, mixing=self.mixing.to(device), bands=bands, pages=None)

    def release(self) -> None:
        """What was read of a file leaves the memory of this process."""
        if self.pages is not None:
            self.pages.release()


def compute_group(
    stored: StoredColumns, order: int, zone: Zone, rings: range, norms: Tensor, n_zones: int
) -> Kernels:
    """The kernels of one group of rings, or what perspective adds to them; without mixtures where that is nothing.

    order    0 of an orthographic camera, 1 and 2 of perspective
    norms    (n,)  of `column_norms`
    n_zones  among which the tolerance is shared, and among groups by their area in the image
    """
    return _Group(stored, order, zone, rings, norms, n_zones).kernels()


def kernel_settings() -> list[object]:
    """What the kernels depend on beside the library and the grid."""
    return [TOLERANCE, BANDS, _TRIM, TEXEL_ROWS, _AZIMUTHS, _MIXTURES, _GRAM_CELLS, *norm_settings()]


def perspective_settings() -> list[object]:
    """What the kernels that perspective adds depend on beside those."""
    return [HELD_DISTANCE, _LOOSER, _TERMS]


class _Group:
    def __init__(
        self, stored: StoredColumns, order: int, zone: Zone, rings: range, norms: Tensor, n_zones: int
    ) -> None:
        self.stored, self.order, self.zone, self.rings, self.norms = stored, order, zone, rings, norms
        gamma, to_rings = zone.ring_quadrature
        to_rings = to_rings[rings.start : rings.stop]
        used = to_rings.amax(0) > 0
        self.to_rings = to_rings[:, used]
        gamma = gamma[used]
        tilt, azimuths = tilt_of(gamma), _AZIMUTHS[zone.index]
        terms = [half_vectors(zone, gamma, part * tilt, azimuths).times(factor) for part, factor in _TERMS[order]]
        self.samples = HalfVectors.sum_of(terms)
        share = zone.ring_measure[rings.start : rings.stop].sum() / zone.ring_measure.sum()
        tolerance = TOLERANCE * (_LOOSER if order else 1)
        self.allowance = tolerance * float(share / (n_zones * 2 * len(BANDS))) ** 0.5

    def kernels(self) -> Kernels:
        mixtures, values, place = self._cell_mixtures()
        first_row, parts = self._spectra(values, place)
        scale = self._scale(first_row, parts.shape[3])
        low_high = self._bands(parts, scale, mixtures)
        places = 4 * (low_high[-1][1] // 2 + 1)
        interpolated = torch.sinc(torch.arange(self.zone.frequencies, dtype=torch.float32) / places).square()
        pairs = []
        total = torch.zeros(mixtures.shape[1], mixtures.shape[1], dtype=torch.float64)
        for low, high in low_high:
            pair = [self._components(part, scale, mixtures, low, high) for part in parts]
            total += sum((vectors * size) @ vectors.T for size, vectors in pair)
            pairs.append([vectors for _, vectors in pair])
        size, basis = _principal(total)
        basis = basis[:, : max(0 if self.order else 1, _needed(mixtures @ basis, size, self.allowance))]
        bands = []
        for (low, high), mixed in zip(low_high, pairs, strict=True):
            even, odd = (_reduced(part[..., low:high], v) for part, v in zip(parts / interpolated, mixed, strict=True))
            bands.append(Band(low, even, odd, *((v.T @ basis).float() for v in mixed)))
        mixing = (self.norms[:, None] * (mixtures @ basis)).float()
        return Kernels(
            self.order, self.zone.index, self.rings.start, len(self.rings), places, first_row, mixing, tuple(bands)
        )

    def _bands(self, parts: Tensor, scale: Tensor, mixtures: Tensor) -> list[tuple[int, int]]:
        """Frequencies from and up to; without the highest, if no column needs them."""
        end = self.zone.frequencies
        while end > _TRIM:
            last = [self._components(part, scale, mixtures, end - _TRIM, end) for part in parts]
            if any(len(size) for size, _ in last):
                break
            end -= _TRIM
        return list(pairwise(sorted({min(edge, end) for edge in (*BANDS, end)})))

    def _components(
        self, part: Tensor, scale: Tensor, mixtures: Tensor, low: int, high: int
    ) -> tuple[Tensor, Tensor]:
        """Sizes (q,) and mixtures (r, q) that a band of real or imaginary parts (r, G, E, M) needs."""
        block = (part[..., low:high] * scale[..., low:high]).flatten(1).double()
        size, vectors = _principal(block @ block.T / pi)
        needed = _needed(mixtures @ vectors, size, self.allowance)
        return size[:needed], vectors[:, :needed]

    def _scale(self, first_row: int, n_rows: int) -> Tensor:
        """(G, E, M): what makes the sum of squares of moments the kernels' square integral, times pi.

        Light counts as far as a probe of TEXEL_ROWS rows can hold it: bilinear between its texels.
        """
        rows = slice(first_row, first_row + n_rows)
        zone = self.zone
        measure = zone.ring_measure[self.rings.start : self.rings.stop, None] * zone.row_measure[rows]
        middle = torch.arange(zone.elevations, dtype=torch.float64)[rows] - 1
        from_pole = (torch.minimum(middle, zone.rows - middle).clamp_min(0) + SUPPORT / 2) * (pi / zone.rows)
        sine = torch.sin(from_pole.clamp_max(pi / 2))
        slowness = torch.arange(zone.frequencies) / (2 * TEXEL_ROWS * sine[:, None])
        texels = 1 / (1 + (pi * slowness).square())  # the envelope of a hat's transform
        return (measure.rsqrt()[..., None] * texels).float()

    def _cell_mixtures(self) -> tuple[Tensor, Tensor, Tensor]:
        """Mixtures (n, r) of the normalised columns that suffice in this group's cells; their values (cells, r)."""
        cells, place = torch.unique(self.samples.cells, return_inverse=True)
        share = self.to_rings.sum(0)[:, None] * self.samples.weights * self.samples.kernel
        importance = torch.zeros(len(cells), dtype=torch.float64)
        for mirrored in place:
            importance.index_add_(0, mirrored.ravel(), share.ravel())
        step = max(1, len(cells) // _GRAM_CELLS)
        gram = torch.zeros(len(self.norms), len(self.norms), dtype=torch.float64)
        for some in torch.arange(0, len(cells), step).split(_ROWS_AT_ONCE):
            rows = self._rows(cells[some]).double() * (step * importance[some]).sqrt()[:, None]
            gram += rows.T @ rows
        size, vectors = _principal(gram)
        allowance = self.allowance * (1 if self.order else 0.3)  # differences lose less
        enough = min(max(1, _needed(vectors, size, allowance)), _MIXTURES)
        vectors = vectors[:, :enough]
        blocks = [self._rows(some) @ vectors.float() for some in cells.split(_ROWS_AT_ONCE)]
        return vectors, torch.cat(blocks), place

    def _rows(self, cells: Tensor) -> Tensor:
        """(N, n): normalised columns."""
        return self.stored.columns[cells].float() * (self.stored.scale / self.norms).float()

    def _spectra(self, values: Tensor, place: Tensor) -> tuple[int, Tensor]:
        """First elevation spline, and conj(kappa) (2, r, G, E, M), real and imaginary, of mixtures (cells, r)."""
        from scipy.sparse import csc_matrix

        zone, samples = self.zone, self.samples
        first, by_row = zone.elevation_splines(samples.beta)
        low, high = int(first.min()), int(first.max()) + SUPPORT
        position = samples.delta * (PLACES * zone.rows / (2 * pi))
        by_delta, node = spline_weights(position), position.floor().long()
        line = int(node.max()) + SUPPORT
        nodes = (
            ((first - low)[..., None] + torch.arange(SUPPORT))[..., None] * line
            + (node[..., None] + torch.arange(SUPPORT))[..., None, :]
        )
        weights = (samples.weights[..., None, None] * by_row[..., None] * by_delta[..., None, :]).float()
        n_nodes = (high - low) * line
        r = values.shape[1]
        moments = torch.zeros(len(self.rings), n_nodes * 2 * r, dtype=torch.float32)
        for some in torch.arange(len(samples.weights)).split(max(1, _BLOCK // (n_nodes * 2 * r))):
            spread = torch.empty(len(some), n_nodes * 2 * r, dtype=torch.float32)
            for row, q in zip(spread, some.tolist(), strict=True):
                seen = samples.weights[q] != 0
                columns = nodes[q][seen].reshape(-1, SUPPORT**2)
                ends = torch.arange(0, columns.numel() + 1, SUPPORT**2)
                matrix = csc_matrix(
                    (weights[q][seen].ravel().numpy(), columns.ravel().int().numpy(), ends.int().numpy()),
                    shape=(n_nodes, len(columns)),
                )
                one, mirrored = (values[side[q][seen]] for side in place)
                pair = torch.cat([one + mirrored, one - mirrored], 1)
                row.copy_(torch.from_numpy(matrix @ pair.numpy()).ravel())
            moments.addmm_(self.to_rings[:, some].float(), spread)
        sides = moments.view(len(self.rings), high - low, line, 2, r).permute(3, 4, 0, 1, 2)
        return low, torch.stack([side @ wave.T for side, wave in zip(sides, waves(zone, line), strict=True)])


def _reduced(part: Tensor, vectors: Tensor) -> Tensor:
    """Spectra (r, G, E, M) of mixtures, mixed by (r, q): (M, E, G q)."""
    return torch.einsum("rgem,rq->megq", part, vectors.float()).flatten(2).contiguous()


def _principal(gram: Tensor) -> tuple[Tensor, Tensor]:
    """Eigenvalues, from the largest, and eigenvectors."""
    size, vectors = torch.linalg.eigh(gram)
    return size.flip(0).clamp_min(0), vectors.flip(1)


def _needed(loadings: Tensor, size: Tensor, allowance: float) -> int:
    """How many of the components (n, r) of size (r,) leave 95 % of the columns within an allowance, all within four."""
    left = (loadings.square() * size).flip(1).cumsum(1).flip(1).sqrt()  # what components i, i + 1, ... hold
    most = torch.maximum(left.quantile(0.95, dim=0), left.amax(0) / 4)
    return int((most > allowance).sum())
