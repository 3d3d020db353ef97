"""Where the harmonic transport keeps its kernels: zones of the half angle, rings of normals, elevations of light.

The kernel of a ring is what a normal at polar angle gamma from the view direction does with light from polar angle
beta and azimuth delta from the normal's: K(gamma, beta, delta) = f_r cos(theta_i). Close to the mirror direction
it may be as sharp as a mirror, elsewhere it is smooth; so it is split by a partition of unity over the half angle
theta_h into zones, and each zone has a grid of its own, as fine as its kernels need.
"""

from dataclasses import dataclass
from functools import cached_property
from math import ceil, pi, radians

import torch
from torch import Tensor

from torchbrdf.transport.harmonic.splines import SUPPORT, banded_dual, design_matrix, gram, spline_weights

_TAPERS = ((1.0, 2.0), (4.0, 8.0), (10.0, 20.0))
"""Half angles in degrees between which a zone hands over to the next."""

_ROWS = (256, 128, 96, 96)
"""Of each zone."""

_RINGS_PER_ROW = (2.4, 2.0, 1.8, 1.5)
"""Knots of rings in the angle of a row of light, in the middle of the image: reflected light turns twice as far."""

_WIDEST = 2.0
"""Largest angle between rings, near the silhouette, in rows of light."""

_QUADRATURE = 3
"""See `Zone`."""

_DUAL_REACH = 9
"""Rings on either side whose moments make a coefficient across the rings."""

RINGS_PER_GROUP = 12

HELD_DISTANCE = 6.0
"""In radii, of the camera from a ball in the strongest perspective that is held."""


@dataclass(frozen=True)
class Zone:
    """A range of half angles and the grid of its kernels.

    index       0 holds the mirror direction
    rows        intervals of the light's polar angle beta, and the highest azimuth frequency
    quadrature  places in an interval between two rings, or elevations, at which integrals are taken
    first       of all zones: it has the half angles of those before it, too
    """

    index: int
    rows: int
    quadrature: int = _QUADRATURE
    first: bool = False

    @property
    def frequencies(self) -> int:
        """Azimuth frequencies, 0 included."""
        return self.rows + 1

    @property
    def reach(self) -> float:
        """Largest half angle in radians."""
        return radians(_TAPERS[self.index][1]) if self.index < len(_TAPERS) else pi / 2

    def window(self, theta_h: Tensor) -> Tensor:
        """The zone's share of the kernel; those of all zones sum to 1."""
        share = torch.ones_like(theta_h)
        if self.index > 0 and not self.first:
            share = share - _handover(theta_h, *_TAPERS[self.index - 1])
        if self.index < len(_TAPERS):
            share = share * _handover(theta_h, *_TAPERS[self.index])
        return share

    @cached_property
    def _ring_table(self) -> tuple[Tensor, Tensor, int]:
        """gamma and the coordinate at which it lies, finely, and the number of intervals.

        Rings are equally far apart in the image, but towards the silhouette, where a pixel shows a wide range of
        normals, never further apart in angle than a few rows of light.
        """
        gamma = torch.linspace(0, pi / 2, 1 << 16, dtype=torch.float64)
        row = pi / self.rows
        density = (torch.cos(gamma) * _RINGS_PER_ROW[self.index]).clamp_min(1 / _WIDEST) / row
        steps = (density[1:] + density[:-1]) / 2 * gamma[1]
        coordinate = torch.cat([torch.zeros(1, dtype=torch.float64), steps.cumsum(0)])
        intervals = ceil(float(coordinate[-1]))
        return gamma, coordinate * (intervals / coordinate[-1]), intervals

    @property
    def intervals(self) -> int:
        """Intervals between the knots of the rings."""
        return self._ring_table[2]

    @property
    def rings(self) -> int:
        """Splines over gamma."""
        return self.intervals + SUPPORT - 1

    @property
    def elevations(self) -> int:
        """Splines over beta."""
        return self.rows + SUPPORT - 1

    @property
    def groups(self) -> list[range]:
        """Rings that share a basis of materials and a range of elevations."""
        return [range(i, min(i + RINGS_PER_GROUP, self.rings)) for i in range(0, self.rings, RINGS_PER_GROUP)]

    def ring_coordinate(self, gamma: Tensor) -> Tensor:
        """(...) float64: polar angles of normals in intervals between rings."""
        table, coordinate, _ = self._ring_table
        position = (gamma.double() / table[1]).clamp(0, len(table) - 1.000001)
        low = position.floor().long()
        return torch.lerp(coordinate[low], coordinate[low + 1], position - low)

    def ring_angle(self, coordinate: Tensor) -> Tensor:
        """(N,) float64: the inverse of `ring_coordinate`."""
        return self._angle_and_slope(coordinate)[0]

    def _angle_and_slope(self, at: Tensor) -> tuple[Tensor, Tensor]:
        gamma, coordinate, _ = self._ring_table
        high = torch.searchsorted(coordinate, at).clamp(1, len(coordinate) - 1)
        step = coordinate[high] - coordinate[high - 1]
        return torch.lerp(gamma[high - 1], gamma[high], (at - coordinate[high - 1]) / step), gamma[1] / step

    def ring_splines(self, gamma: Tensor) -> tuple[Tensor, Tensor]:
        """First spline (...) int64 and the values of four (..., 4) at polar angles of normals."""
        x = self.ring_coordinate(gamma).clamp(0, self.intervals - 1e-9)
        return x.floor().long(), spline_weights(x)

    @cached_property
    def _ring_places(self) -> tuple[Tensor, Tensor, Tensor]:
        """gamma (Q,) of the quadrature, the splines there (Q, rings), and the image's measure (Q,)."""
        places = _places(self.intervals, self.quadrature)
        at, slope = self._angle_and_slope(places)
        measure = torch.sin(at) * torch.cos(at) * slope / self.quadrature
        return at, design_matrix(places, self.intervals), measure

    @cached_property
    def ring_quadrature(self) -> tuple[Tensor, Tensor]:
        """gamma (Q,), and what turns values there into moments with the rings' splines (rings, Q) over the image."""
        gamma, design, measure = self._ring_places
        return gamma, (design * measure[:, None]).T

    @cached_property
    def ring_dual(self) -> Tensor:
        """(rings, rings): moments over the image -> coefficients of the splines over gamma."""
        _, design, measure = self._ring_places
        return banded_dual(gram(design, measure), _DUAL_REACH)

    @cached_property
    def ring_measure(self) -> Tensor:
        """(rings,): the image's area under each spline, over 2 pi; the sphere's disc has area pi."""
        return self.ring_quadrature[1].sum(1)

    @cached_property
    def _elevation_places(self) -> tuple[Tensor, Tensor]:
        places = _places(self.rows, self.quadrature)
        step = pi / self.rows
        return design_matrix(places, self.rows), torch.sin(places * step) * (step / self.quadrature)

    @cached_property
    def row_measure(self) -> Tensor:
        """(elevations,): the sphere's measure under each spline, over 2 pi."""
        design, measure = self._elevation_places
        return design.T @ measure

    def elevation_splines(self, beta: Tensor) -> tuple[Tensor, Tensor]:
        """First spline (...) int64 and the values of four (..., 4) at polar angles of light."""
        x = (beta * (self.rows / pi)).clamp(0, self.rows - 1e-9)
        return x.floor().long(), spline_weights(x)

    def light_projection(self, lines: int) -> Tensor:
        """(elevations, lines) float32: radiance on lines of equal beta, at their middles -> the nearest spline."""
        beta = (torch.arange(lines, dtype=torch.float64) + 0.5) * (pi / lines)
        design = design_matrix(beta * (self.rows / pi), self.rows)
        measure = torch.sin(beta) * (pi / lines)
        projection = torch.linalg.solve(gram(design, measure), (design * measure[:, None]).T)
        return torch.where(projection.abs() > 1e-7 * projection.abs().max(), projection, 0).float()  # no denormals


def _handover(theta_h: Tensor, start: float, end: float) -> Tensor:
    t = ((radians(end) - theta_h) / radians(end - start)).clamp(0, 1)
    return t * t * (3 - 2 * t)


def tilt_of(gamma: Tensor, distance: float = HELD_DISTANCE) -> Tensor:
    """How far view directions are tilted away from the normal on rings gamma, by default in the strongest perspective.

    distance  in radii, of the camera from the ball's middle
    A ring is named by the normal half way between the axis and the mirror direction: in perspective, the normal's
    polar angle and half of the tilt. Where the ball ends, the view is grazing.
    """
    half = torch.atan2(torch.sin(gamma), 2 * distance - torch.cos(gamma))
    return 2 * torch.minimum(half, pi / 2 - gamma)


def zones() -> list[Zone]:
    """All zones, from the mirror direction outwards."""
    return [Zone(i, rows) for i, rows in enumerate(_ROWS)]


def _places(intervals: int, quadrature: int) -> Tensor:
    return (torch.arange(intervals * quadrature, dtype=torch.float64) + 0.5) / quadrature


def settings() -> list[object]:
    """What the grid depends on."""
    return [_TAPERS, _ROWS, _RINGS_PER_ROW, _WIDEST, _QUADRATURE, RINGS_PER_GROUP]
