"""Integrals of the kernels of a group of rings: their Fourier series in delta, for splines over gamma and beta.

Half vectors are sampled: places in theta_h follow the cells of MERL's grid, so lobes as sharp as a table can hold are
integrated, not sampled. (Averages over texels of the light, by contrast, miss most of a mirror's lobe.)
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import pi

import torch
from torch import Tensor

from torchbrdf.brdf import StoredColumns, lower_gram, mirrored_cells
from torchbrdf.transport.harmonic._bags import Bags
from torchbrdf.transport.harmonic._half_vectors import HalfVectors, half_vectors
from torchbrdf.transport.harmonic._waves import PLACES, waves
from torchbrdf.transport.harmonic.grid import Zone, tilt_of
from torchbrdf.transport.harmonic.splines import SUPPORT, spline_weights

_TERMS = ({0.0: 1.0}, {0.0: -1.0, 1.0: 1.0}, {0.0: -0.5, 0.5: 1.0, 1.0: -0.5})
"""Factors by shares of `tilt_of`: kernels without tilt, and the differences that interpolate to others.

With a share t of the tilt the kernels are those of order 0, t times those of 1, and 4 t (1 - t) times those of 2.
"""

_AZIMUTHS = (64, 96, 128, 192)
"""Half vectors on a half circle about the normal, by zone."""

_PAIRS_AT_ONCE = 1 << 10
_BLOCK = 1 << 23
"""Floats of spread samples held at once."""


@dataclass(frozen=True)
class Mixtures:
    """Mixtures of a library's columns (n, r + s) float64: r for the kernels' even part, then s for the odd one."""

    loadings: Tensor
    r: int

    def parts(self, values: Tensor, dim: int) -> tuple[Tensor, Tensor]:
        """The r and the s along a dimension of r + s."""
        even, odd = values.split([self.r, values.shape[dim] - self.r], dim)
        return even, odd


@dataclass(frozen=True)
class Cells:
    """Pairs of cells that mirror each other, (N,) by their first, and which of them Q places across the rings meet.

    met    (Q, S) for every tilt
    sides  (Q, S) for every tilt: 1 where the first of the pair lies at delta > 0, else -1
    """

    places: Tensor
    cells: Tensor
    met: list[Tensor]
    sides: list[Tensor]


class GroupIntegrals:
    """Of the columns of a library, for some rings of a zone.

    orders     0 without tilt, 1 and 2 for what perspective adds
    to_rings   (G, Q): what turns values at Q places across the rings into moments with the rings' splines
    first_row  splines over elevation first_row, ..., first_row + n_rows - 1 that meet a half vector
    line       nodes over delta for each of them, per_delta in a radian
    """

    def __init__(self, stored: StoredColumns, orders: Sequence[int], zone: Zone, rings: range) -> None:
        """Half vectors at all places."""
        self.stored, self.zone = stored, zone
        gamma, to_rings = zone.ring_quadrature
        to_rings = to_rings[rings.start : rings.stop]
        used = to_rings.amax(0) > 0
        self.to_rings, gamma = to_rings[:, used].float(), gamma[used]
        shares = sorted({share for order in orders for share in _TERMS[order]})
        factors = [[_TERMS[order].get(share, 0.0) for share in shares] for order in orders]
        self.factors = torch.tensor(factors, dtype=torch.float32)
        tilt, azimuths = tilt_of(gamma), _AZIMUTHS[zone.index]
        self.samples = [half_vectors(zone, gamma, share * tilt, azimuths) for share in shares]
        firsts = [zone.elevation_splines(samples.beta)[0] for samples in self.samples]
        self.first_row = min(int(first.min()) for first in firsts)
        self.n_rows = max(int(first.max()) for first in firsts) + SUPPORT - self.first_row
        self.per_delta = PLACES * zone.rows / (2 * pi)
        self.line = max(int((samples.delta.max() * self.per_delta).floor()) for samples in self.samples) + SUPPORT

    @property
    def n_places(self) -> int:
        """Across the rings."""
        return self.to_rings.shape[1]

    @property
    def n_nodes(self) -> int:
        """Of a place: a line for each spline over elevation."""
        return self.n_rows * self.line

    def cells(self, places: Tensor) -> Cells:
        """Those that some places (Q,) meet."""
        met = [samples.cells[places] for samples in self.samples]
        there = [mirrored_cells(some) for some in met]
        first = [torch.minimum(*both) for both in zip(met, there, strict=True)]
        cells, index = torch.unique(torch.cat([some.ravel() for some in first]), return_inverse=True)
        parts = index.split([some.numel() for some in met])
        sides = [torch.where(one < other, 1.0, -1.0).float() for one, other in zip(met, there, strict=True)]
        return Cells(places, cells, [part.view_as(some) for part, some in zip(parts, met, strict=True)], sides)

    def power(self, seen: Cells) -> Tensor:
        """(N,) float64: integrals of the squared kernel that is 1 in one cell, summed over places and tilts."""
        found = torch.zeros(len(seen.cells), dtype=torch.float64)
        for samples, met in zip(self.samples, seen.met, strict=True):
            found.index_add_(0, met.ravel(), (samples.weights * samples.kernel)[seen.places].ravel())
        return found

    def gram(self, cells: Tensor, power: Tensor) -> Tensor:
        """(n, n) float64, see `lower_gram`: of the columns in pairs of cells (N,) that count by a power (N,)."""
        n = self.stored.columns.shape[1]
        found = torch.zeros(n, n, dtype=torch.float64)
        for some, share in zip(cells.split(_PAIRS_AT_ONCE), power.split(_PAIRS_AT_ONCE), strict=True):
            for cell in (some, mirrored_cells(some)):
                rows = self.stored.columns[cell].double() * share.sqrt()[:, None]
                found += lower_gram(rows.T)
        return self.stored.scale[:, None] * found * self.stored.scale

    def spread(self, seen: Cells, mixtures: Mixtures) -> Iterator[tuple[slice, Tensor]]:
        """Mixtures spread on nodes by the splines: some of the places after the others, and (Q, orders, E line, r + s).

        They are as many at once as `_BLOCK` holds, at least one.
        """
        values = self._values(seen.cells, mixtures)
        together = max(1, _BLOCK // (len(self.factors) * self.n_nodes * values.shape[1]))
        for start in range(0, len(seen.places), together):
            some = slice(start, min(start + together, len(seen.places)))
            by_tilt = [
                self._spread(samples, seen.places[some], mixtures, values, met[some], sides[some])
                for samples, met, sides in zip(self.samples, seen.met, seen.sides, strict=True)
            ]
            if len(by_tilt) == 1:
                yield some, by_tilt[0][:, None]
            else:
                yield some, torch.einsum("pt,tqnk->qpnk", self.factors, torch.stack(by_tilt))

    def spectra(self, mixtures: Mixtures) -> list[tuple[Tensor, Tensor]]:
        """conj(kappa) of every order: real parts (G, E, r, M) of r mixtures, imaginary ones (G, E, s, M) of s."""
        n_orders, size = len(self.factors), self.n_nodes * mixtures.loadings.shape[1]
        moments = self.to_rings.new_zeros(n_orders, len(self.to_rings), size)
        for some, there in self.spread(self.cells(torch.arange(self.n_places)), mixtures):
            near = torch.nonzero(self.to_rings[:, some].amax(1) > 0).ravel()
            rings = slice(int(near[0]), int(near[-1]) + 1)
            for sums, of_order in zip(moments, there.flatten(2).unbind(1), strict=True):
                sums[rings].addmm_(self.to_rings[rings, some], of_order)
        cosines, sines = waves(self.zone, self.line)
        found = []
        for sums in moments.view(n_orders, len(self.to_rings), self.n_rows, self.line, -1).transpose(3, 4):
            even, odd = mixtures.parts(sums, 2)
            found.append((even @ cosines.T, odd @ sines.T))
        return found

    def _values(self, cells: Tensor, mixtures: Mixtures) -> Tensor:
        """(N, r + s): sums of r mixtures over pairs of cells, and differences of s."""
        loadings = (self.stored.scale[:, None] * mixtures.loadings).float()
        values = loadings.new_empty(len(cells), loadings.shape[1])
        even, odd = mixtures.parts(loadings, 1)
        for some, found in zip(cells.split(_PAIRS_AT_ONCE), values.split(_PAIRS_AT_ONCE), strict=True):
            one, other = (self.stored.columns[cell].float() for cell in (some, mirrored_cells(some)))
            sums, differences = mixtures.parts(found, 1)
            torch.mm(one + other, even, out=sums)
            torch.mm(one.sub_(other), odd, out=differences)
        return values

    def _spread(
        self, samples: HalfVectors, places: Tensor, mixtures: Mixtures, values: Tensor, met: Tensor, sides: Tensor
    ) -> Tensor:
        """(Q, E line, r + s): of one tilt at places (Q,), from pairs of cells met (Q, S), each from its side (Q, S)."""
        lit = samples.weights[places] != 0
        weight, beta, delta = (of_samples[places][lit] for of_samples in (samples.weights, samples.beta, samples.delta))
        first, by_row = self.zone.elevation_splines(beta)
        position = delta * self.per_delta
        place, steps = torch.nonzero(lit)[:, 0], torch.arange(SUPPORT, dtype=torch.int32)
        node = (place * self.n_nodes + (first - self.first_row) * self.line + position.floor().long()).int()
        nodes = node[:, None] + (steps[:, None] * self.line + steps).ravel()
        shares = (weight[:, None] * by_row)[..., None] * spline_weights(position)[:, None]
        bags = Bags.of(nodes, shares.flatten(1).float(), len(places) * self.n_nodes)
        seen = values.index_select(0, met[lit])
        mixtures.parts(seen, 1)[1].mul_(sides[lit][:, None])
        return bags.sums(seen).unflatten(0, (len(places), -1))


def perspective_terms() -> list[object]:
    """What integrals of perspective depend on beside those of no tilt."""
    return [list(term.items()) for term in _TERMS]


def integral_settings() -> list[object]:
    """What integrals depend on beside the library, the zone and the rings."""
    return [_AZIMUTHS]
