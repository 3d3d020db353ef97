"""The light-independent side of the harmonic transport of a single table: finer than a library's, not compressed.

As in `_kernels`, half vectors follow the rows of MERL's grid, so lobes as sharp as a table can hold are integrated.
They are as many as the knots of the light can tell apart. Errors: docs/transport.md.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import ceil, pi, radians

import numpy as np
import torch
from torch import Tensor

from torchbrdf.brdf import GRID
from torchbrdf.transport.harmonic._waves import PLACES, waves
from torchbrdf.transport.harmonic.grid import Zone, tilt_of
from torchbrdf.transport.harmonic.splines import SUPPORT, spline_weights

_FEWEST_AZIMUTHS = 6

_DEGREE = 180 / pi


@dataclass(frozen=True)
class Detail:
    """How finely a table and its light are seen.

    rows, quadrature  of each zone, see `Zone`
    azimuths          half vectors about the normal for each knot of light that they pass, by zone
    step              most knots that the light moves by between two half vectors of a meridian
    lines, blur       of the light, see `TurningLight`
    """

    rows: tuple[int, ...]
    quadrature: tuple[int, ...]
    azimuths: tuple[float, ...]
    step: float
    lines: int
    blur: float

    @property
    def zones(self) -> tuple[Zone, ...]:
        """The zones of single tables."""
        return _zones(self.rows, self.quadrature)


EXACT = Detail((512, 256, 96, 96), (2, 2, 2, 3), (1.25, 1.25, 1.25, 3.0), 0.45, 1152, radians(0.025))
"""Within 0.5 % of converged, mirrors and small lamps included."""

SHOWN = Detail((256, 128, 96, 96), (2, 2, 2, 2), (1.25, 1.25, 1.25, 2.0), 0.9, 576, radians(0.05))
"""For pictures that are only looked at: within 1 %, but 3 % for mirrors under small lamps, in half the time."""


@lru_cache(maxsize=4)
def _zones(rows: tuple[int, ...], quadrature: tuple[int, ...]) -> tuple[Zone, ...]:
    return tuple(Zone(i, *each) for i, each in enumerate(zip(rows, quadrature, strict=True)))


@dataclass(frozen=True)
class TableKernels:
    """Of a group of G rings: 2 pi times the conjugate Fourier series over azimuth of a table's kernels.

    first_row, n_rows  splines over elevation first_row, ..., first_row + E - 1
    even               (3, M, E, G) float32: real parts of each channel
    odd                imaginary parts likewise; None where there are none
    """

    first_row: int
    n_rows: int
    even: Tensor
    odd: Tensor | None = None


def table_kernels(
    values: Tensor, symmetric: bool, detail: Detail, zone: Zone, rings: range, frequencies: int, distance: float | None
) -> TableKernels:
    """The kernels of one group of rings.

    values       (cells, 3) float32: f_r
    symmetric    whether it is the same for phi_d and -phi_d
    frequencies  of azimuth that are wanted, M at most
    distance     of the camera from a ball in radii; None without perspective
    """
    from scipy.sparse import csc_matrix

    gamma, to_rings = zone.ring_quadrature
    to_rings = to_rings[rings.start : rings.stop]
    used = to_rings.amax(0) > 0
    samples = _HalfVectors.of(detail, zone, gamma[used], distance)
    first, by_row = _split(samples.beta * (zone.rows / pi), zone.rows)
    place, by_place = _split(samples.delta * (PLACES * zone.rows / (2 * pi)), PLACES * zone.rows)
    low, n_rows, line = int(first.min()), int(first.max() - first.min()) + 1, int(place.max()) + SUPPORT
    seen = values[samples.cell]
    if not symmetric:
        mirrored = values[samples.mirrored]
        seen = torch.stack([seen + mirrored, seen - mirrored], 1).flatten(1) / 2
    by_row *= samples.weight[:, None]
    node = (samples.ring * n_rows + (first - low)) * line + place
    near = node[:, None] + torch.arange(SUPPORT, dtype=torch.int32)
    ends = np.arange(0, near.numel() + 1, SUPPORT, dtype=np.int32)
    shape = (int(used.sum()) * n_rows * line, len(node))
    spread = csc_matrix((by_place.ravel().numpy(), near.ravel().numpy(), ends), shape=shape)
    each = (by_row[:, :, None] * seen[:, None]).flatten(1)
    moments = torch.from_numpy(spread @ each.numpy()).view(-1, n_rows * line * each.shape[1])
    shifted = (to_rings[:, used].float() @ moments).view(len(rings), n_rows, line, SUPPORT, -1, 3)
    whole = moments.new_zeros(shifted.shape[4], 3, line, n_rows + SUPPORT - 1, len(rings))
    for i in range(SUPPORT):
        whole[:, :, :, i : i + n_rows] += shifted[:, :, :, i].permute(3, 4, 2, 1, 0)
    frequencies = min(frequencies, zone.frequencies)
    even, *odd = (
        torch.matmul(wave, part.flatten(2)).view(3, len(wave), -1, len(rings))
        for wave, part in zip(waves(zone, line, frequencies), whole, strict=False)
    )
    return TableKernels(low, even.shape[2], even, *odd)


def _split(position: Tensor, end: int) -> tuple[Tensor, Tensor]:
    """First spline (N,) int32 and the values of four (N, 4) at places from 0 to an end, in knots."""
    position = position.clamp_(0, end * (1 - torch.finfo(torch.float32).eps))
    return position.int(), spline_weights(position)


@dataclass(frozen=True)
class _HalfVectors:
    """N half vectors on one side of the normal, for Q polar angles of normals.

    ring            (N,) int32: which of those angles
    cell, mirrored  (N,) int32: of the table, and of the half vector's mirror image
    weight          (N,) the kernel times the measure of the light, of both sides
    beta, delta     (N,) of the light, delta in [0, pi]
    """

    ring: Tensor
    cell: Tensor
    mirrored: Tensor
    weight: Tensor
    beta: Tensor
    delta: Tensor

    @staticmethod
    def of(detail: Detail, zone: Zone, gamma: Tensor, distance: float | None) -> "_HalfVectors":
        """In the frame of the normal, whose first axis points down from the view direction."""
        (sin_h, cos_h), (sin_p, cos_p), measure, row = _meridians(zone, detail.azimuths[zone.index], detail.step)
        tilt = torch.zeros_like(gamma) if distance is None else tilt_of(gamma, distance)
        sin_v, cos_v = (wave(gamma + tilt / 2).float()[:, None] for wave in (torch.sin, torch.cos))
        sin_g, cos_g = (wave(gamma - tilt / 2).float()[:, None] for wave in (torch.sin, torch.cos))
        along = cos_v * cos_h - sin_v * sin_h * cos_p  # h . v
        x, y, z = 2 * along * sin_h * cos_p + sin_v, 2 * along * sin_h * sin_p, 2 * along * cos_h - cos_v
        lit = (along > 0) & (z > 0)
        # The view direction in the frame of the half vector; the light's lies opposite.
        across, beside = -cos_h * cos_p * sin_v - sin_h * cos_v, sin_p * sin_v
        theta_d = (torch.atan2(torch.hypot(across, beside), along) * _DEGREE).int().clamp_(0, GRID[1] - 1)
        phi_d = torch.atan2(-beside, -across)
        column = (torch.remainder(phi_d, pi) * (GRID[2] / pi)).int().clamp_(0, GRID[2] - 1)
        first = row + theta_d * GRID[2]
        down, up = x * cos_g + z * sin_g, z * cos_g - x * sin_g
        beta, delta = torch.atan2(torch.hypot(down, y), up), torch.atan2(y, down).abs()
        ring = torch.arange(len(gamma), dtype=torch.int32)[:, None].expand_as(lit)
        mirrored = first + (GRID[2] - 1) - column
        chosen = torch.nonzero(lit.ravel()).ravel()
        parts = (ring, first + column, mirrored, 8 * measure * along * z, beta, delta)
        return _HalfVectors(*(part.reshape(-1)[chosen] for part in parts))


@lru_cache(maxsize=8)
def _meridians(
    zone: Zone, azimuths: float, step: float
) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor], Tensor, Tensor]:
    """Sine and cosine of theta_h and of phi_h, the measure times the zone's window, and the first cell of the row."""
    edges = ((torch.arange(GRID[0] + 1, dtype=torch.float64) / GRID[0]) ** 2 * (pi / 2)).tolist()
    knot = pi / zone.rows
    points = []
    for i, (low, high) in enumerate(pairwise(edges)):
        if low < zone.reach:
            middle, half = (high + low) / 2, (high - low) / 2
            nodes, weights = np.polynomial.legendre.leggauss(max(1, ceil(4 * half / (knot * step))))
            points += [(i, middle + half * node, half * weight) for node, weight in zip(nodes, weights, strict=True)]
    row, meridian, reach = (torch.tensor(each, dtype=torch.float64) for each in zip(*points, strict=True))
    passed = pi * torch.sin((2 * meridian).clamp_max(pi / 2)) / knot
    count = (azimuths * passed).ceil().clamp_min(_FEWEST_AZIMUTHS)
    measure = reach * torch.sin(meridian) * zone.window(meridian) * (pi / count)
    count = torch.where(measure > 0, count, 0).long()
    theta_h, measure, apart = (each.repeat_interleave(count) for each in (meridian, measure, pi / count))
    phi_h = (torch.cat([torch.arange(n) for n in count.tolist()]) + 0.5) * apart
    first = (GRID[1] * GRID[2] * row.int()).repeat_interleave(count)
    waves = [(torch.sin(angle).float(), torch.cos(angle).float()) for angle in (theta_h, phi_h)]
    return waves[0], waves[1], measure.float(), first
