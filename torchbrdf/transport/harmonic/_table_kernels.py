"""The light-independent side of the harmonic transport of a single table: finer than a library's, not compressed.

As in `_integrals`, half vectors follow the rows of MERL's grid, so lobes as sharp as a table can hold are integrated.
They are as many as the knots of the light can tell apart, and end where the light meets the horizon: what they are, and
where their light falls, is the same for all tables and remembered. Errors: docs/transport.md.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import ceil, log, pi, radians

import numpy as np
import torch
from torch import Tensor

from torchbrdf.brdf import GRID, mirrored_cells, row_edges
from torchbrdf.lasting import lasting, on_disk
from torchbrdf.transport.harmonic._bags import Bags
from torchbrdf.transport.harmonic._waves import PLACES, waves
from torchbrdf.transport.harmonic.grid import Zone, settings, tilt_of
from torchbrdf.transport.harmonic.splines import SUPPORT, spline_weights

_FEWEST_AZIMUTHS = 6

_CROWDED = 3.0
"""Azimuths next to the horizon that are closer together than others."""

_MORE = 6
"""Azimuths for these, beside those for the knots of light."""

_TURNING = 16
"""Frequencies of azimuth that are wanted beside those of knots on the widest circle of light."""

_DEGREE = 180 / pi

_TOGETHER = 24
"""Polar angles of normals in a group, at most."""

_NODES = 1 << 16
"""Of a group, about: what a core's cache holds."""


@dataclass(frozen=True)
class Detail:
    """How finely a table and its light are seen.

    rows, quadrature  of each zone, see `Zone`
    azimuths          half vectors about the normal for each knot of light that they pass, by zone
    step              most knots that the light moves by between two half vectors of a meridian
    lines, blur       of the light, see `TurningLight`
    merged            how many of the zones, from the mirror direction, are left to the one after them
    on_disk           whether half vectors under an orthographic camera are kept in the cache, 50 bytes each
    """

    rows: tuple[int, ...]
    quadrature: tuple[int, ...]
    azimuths: tuple[float, ...]
    step: float
    lines: int
    blur: float
    merged: int = 0
    on_disk: bool = False

    @property
    def zones(self) -> tuple[Zone, ...]:
        """The zones of single tables."""
        return _zones(self.rows, self.quadrature, self.merged)


EXACT = Detail((512, 256, 96, 96), (2, 2, 2, 2), (1.25, 1.25, 1.25, 1.5), 0.5, 1152, radians(0.025))
"""Within 0.5 % of converged, mirrors and small lamps included."""

SHOWN = Detail((256, 128, 96, 80), (2, 2, 2, 2), (1.25, 1.25, 1.25, 1.5), 0.9, 576, radians(0.05), on_disk=True)
"""For pictures that are only looked at: within 1 %, but 3 % for mirrors under small lamps, in half the time."""


@lru_cache(maxsize=8)
def _zones(rows: tuple[int, ...], quadrature: tuple[int, ...], merged: int) -> tuple[Zone, ...]:
    return tuple(Zone(i, rows[i], quadrature[i], 0 < i == merged) for i in range(merged, len(rows)))


@dataclass(frozen=True, eq=False)
class Reflections:
    """N half vectors on one side of the normal for G polar angles of normals, and where they send light from.

    first      the first of those angles
    count      G
    first_row  splines over elevation first_row, ..., first_row + E - 1
    n_rows     E
    line       nodes over azimuth, see `waves`
    turning    frequencies of azimuth that the half vectors resolve there
    cell       (N,) int32: of the table
    by_row     (N, 4): values of splines over elevation times the kernel and the measure of the light, of both sides
    bags       half vectors on nodes: azimuth, then first spline over elevation, then polar angle of the normal
    """

    first: int
    count: int
    first_row: int
    n_rows: int
    line: int
    turning: int
    cell: Tensor
    by_row: Tensor
    bags: Bags

    @property
    def layout(self) -> list[int]:
        """What is a number."""
        return [self.first, self.count, self.first_row, self.n_rows, self.line, self.turning]

    @property
    def tensors(self) -> dict[str, Tensor]:
        """What is not."""
        return {"cell": self.cell, "by_row": self.by_row, **vars(self.bags)}

    @classmethod
    def of(cls, layout: Sequence[int], tensors: Mapping[str, Tensor]) -> "Reflections":
        """The inverse."""
        first, count, first_row, n_rows, line, turning = layout
        bags = Bags(tensors["sample"], tensors["share"], tensors["ends"])
        return cls(first, count, first_row, n_rows, line, turning, tensors["cell"], tensors["by_row"], bags)

    def kernels(self, zone: Zone, values: Tensor, symmetric: bool, frequencies: int) -> list[Tensor]:
        """2 pi times the conjugate Fourier series over azimuth of a table's kernels, (M, E, G, 3) each.

        values       (cells, 3) float32: f_r
        symmetric    whether it is the same for phi_d and -phi_d
        frequencies  of azimuth that are wanted, M
        returns      the real parts; and the imaginary ones where there are some
        """
        seen = values.index_select(0, self.cell)
        if not symmetric:
            there = values.index_select(0, mirrored_cells(self.cell))
            seen = torch.cat([seen + there, seen - there], 1).mul_(0.5)
        nodes = self._nodes(seen)
        return [
            (wave[:frequencies] @ part.flatten(1)).view(frequencies, self.n_rows, self.count, 3)
            for wave, part in zip(waves(zone, self.line, self.turning), nodes, strict=False)
        ]

    def _nodes(self, seen: Tensor) -> Tensor:
        """(p, line, E, G, 3): f_r, or its even and odd part in phi_d, (N, 3 p), on nodes of azimuth and elevation."""
        each = seen.new_empty(len(seen), SUPPORT, seen.shape[1])
        for i in range(SUPPORT):  # half of the time that broadcasting takes
            torch.mul(seen, self.by_row[:, i : i + 1], out=each[:, i])
        sums = self.bags.sums(each.flatten(1)).view(self.line, -1, self.count, SUPPORT, seen.shape[1] // 3, 3)
        whole = sums.new_zeros(sums.shape[4], self.line, self.n_rows, self.count, 3)
        for i in range(SUPPORT):
            whole[:, :, i : i + sums.shape[1]] += sums[:, :, :, i].movedim(3, 0)
        return whole


@lru_cache(maxsize=16)
@lasting
def reflections(detail: Detail, zone: Zone, distance: float | None) -> tuple[Reflections, ...]:
    """For all polar angles of normals of a zone's `ring_quadrature`.

    distance  of the camera from a ball in radii; None without perspective
    """
    if not detail.on_disk or distance is not None:
        return tuple(_reflections(detail, zone, distance))

    def made() -> dict[str, Tensor]:
        found = list(_reflections(detail, zone, distance))
        tensors = {f"{i} {name}": tensor for i, one in enumerate(found) for name, tensor in one.tensors.items()}
        return tensors | {"layout": torch.tensor([one.layout for one in found])}

    seen = [detail.azimuths[zone.index], detail.step, zone.index, zone.rows, zone.quadrature, zone.first]
    kept = on_disk("reflections", [*seen, _FEWEST_AZIMUTHS, _CROWDED, _MORE, _TURNING, PLACES, settings()], made)
    layouts = kept.pop("layout").tolist()
    parts: list[dict[str, Tensor]] = [{} for _ in layouts]
    for name, tensor in kept.items():
        i, part = name.split()
        parts[int(i)][part] = tensor
    return tuple(Reflections.of(layout, part) for layout, part in zip(layouts, parts, strict=True))


def _reflections(detail: Detail, zone: Zone, distance: float | None) -> Iterator[Reflections]:
    gamma, _ = zone.ring_quadrature
    first, together = 0, 1
    while first < len(gamma):
        some = gamma[first : first + together]
        samples = _HalfVectors.of(detail, zone, some, distance)
        row, by_row = _split(samples.beta * (zone.rows / pi), zone.rows)
        place, by_place = _split(samples.delta * (PLACES * zone.rows / (2 * pi)), PLACES * zone.rows)
        low, n_rows, line = int(row.min()), int(row.max() - row.min()) + 1, int(place.max()) + SUPPORT
        node = (place * n_rows + (row - low)) * len(some) + samples.ring
        near = node[:, None] + torch.arange(SUPPORT, dtype=torch.int32) * (n_rows * len(some))
        bags = Bags.of(near, by_place, line * n_rows * len(some))
        by_row *= samples.weight[:, None]
        widest = float(torch.sin(samples.beta).amax())
        turning = min(zone.frequencies, ceil(zone.rows * widest) + _TURNING)
        yield Reflections(
            first, len(some), low, n_rows + SUPPORT - 1, line, turning, samples.cell, by_row, bags
        )  # fmt: skip
        first += len(some)
        together = max(1, min(_TOGETHER, len(gamma) - first, _NODES // (line * n_rows)))


def _split(position: Tensor, end: int) -> tuple[Tensor, Tensor]:
    """First spline (N,) int32 and the values of four (N, 4) at places from 0 to an end, in knots."""
    position = position.clamp_(0, end * (1 - torch.finfo(torch.float32).eps))
    return position.int(), spline_weights(position)


@dataclass(frozen=True)
class _HalfVectors:
    """N half vectors on one side of the normal, for Q polar angles of normals.

    ring         (N,) int32: which of those angles
    cell         (N,) int32: of the table
    weight       (N,) the kernel times the measure of the light, of both sides
    beta, delta  (N,) of the light, delta in [0, pi]
    """

    ring: Tensor
    cell: Tensor
    weight: Tensor
    beta: Tensor
    delta: Tensor

    @staticmethod
    def of(detail: Detail, zone: Zone, gamma: Tensor, distance: float | None) -> "_HalfVectors":
        """In the frame of the normal, whose first axis points down from the view direction."""
        theta_h, measure, azimuths, row = _meridians(zone, detail.azimuths[zone.index], detail.step)
        tilt = torch.zeros_like(gamma) if distance is None else tilt_of(gamma, distance)
        seen, named = gamma + tilt / 2, gamma - tilt / 2
        # Light is above the horizon where the half vector's azimuth is beyond this.
        edge = torch.acos((1 / (torch.tan(2 * theta_h) * torch.tan(seen)[:, None])).clamp(-1, 1))
        beside = torch.sin(seen)[:, None].square() + (torch.cos(seen)[:, None] * torch.cos(theta_h)).square()
        fastest = torch.maximum(beside.sqrt(), torch.cos(theta_h - seen[:, None]))
        count = (azimuths * fastest * (1 - edge / pi) + _MORE * (edge > 0)).ceil().clamp_min(_FEWEST_AZIMUTHS)
        count = torch.where(edge < pi, count, 0).ravel().long()
        share = (1 / count.float()).repeat_interleave(count)
        place = torch.arange(len(share)) - (count.cumsum(0) - count).repeat_interleave(count)
        at = (place.float() + 0.5) * share
        ring, meridian = (
            index.expand_as(edge).ravel().repeat_interleave(count)
            for index in (torch.arange(len(gamma))[:, None], torch.arange(len(theta_h)))
        )
        edge = edge.ravel().repeat_interleave(count)
        close, density = _close_to_edge(at, _CROWDED * share)
        clipped = edge > 0
        phi_h = torch.where(clipped, edge + (pi - edge) * close, at * pi)
        measure = (measure[meridian] * torch.where(clipped, (pi - edge) * density, pi) * share).float()
        sin_h, cos_h = (wave(theta_h).float()[meridian] for wave in (torch.sin, torch.cos))
        sin_p, cos_p = (wave(phi_h).float() for wave in (torch.sin, torch.cos))
        sin_v, cos_v = (wave(seen).float()[ring] for wave in (torch.sin, torch.cos))
        sin_g, cos_g = (wave(named).float()[ring] for wave in (torch.sin, torch.cos))
        along = cos_v * cos_h - sin_v * sin_h * cos_p  # h . v
        x, y, z = 2 * along * sin_h * cos_p + sin_v, 2 * along * sin_h * sin_p, 2 * along * cos_h - cos_v
        # The view direction in the frame of the half vector; the light's lies opposite.
        across, beside = -cos_h * cos_p * sin_v - sin_h * cos_v, sin_p * sin_v
        theta_d = (torch.atan2(torch.hypot(across, beside), along) * _DEGREE).int().clamp_(0, GRID[1] - 1)
        phi_d = torch.atan2(-beside, -across)
        column = (torch.remainder(phi_d, pi) * (GRID[2] / pi)).int().clamp_(0, GRID[2] - 1)
        cell = row[meridian] + theta_d * GRID[2] + column
        down, up = x * cos_g + z * sin_g, z * cos_g - x * sin_g
        beta, delta = torch.atan2(torch.hypot(down, y), up), torch.atan2(y, down).abs()
        return _HalfVectors(ring.int(), cell, 8 * measure * (along * z).clamp_min(0), beta, delta)


def _close_to_edge(at: Tensor, width: Tensor) -> tuple[Tensor, Tensor]:
    """Places from 0 to 1 that crowd towards 0, evenly about it, and by how much they are spread there."""

    def log_cosh(x: Tensor) -> Tensor:
        return x + torch.log1p(torch.exp(-2 * x)) - log(2)

    whole = log_cosh(1 / width)
    return log_cosh(at / width) / whole, torch.tanh(at / width) / (whole * width)


@lru_cache(maxsize=8)
def _meridians(
    zone: Zone, azimuths: float, step: float
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """theta_h, the measure times the zone's window, azimuths of a half circle, and the first cell of the row."""
    knot = pi / zone.rows
    points = []
    for i, (low, high) in enumerate(pairwise(row_edges().tolist())):
        if low < zone.reach:
            middle, half = (high + low) / 2, (high - low) / 2
            nodes, weights = np.polynomial.legendre.leggauss(max(1, ceil(4 * half / (knot * step))))
            points += [(i, middle + half * node, half * weight) for node, weight in zip(nodes, weights, strict=True)]
    row, meridian, reach = (torch.tensor(each, dtype=torch.float64) for each in zip(*points, strict=True))
    passed = 2 * pi * torch.sin(meridian) / knot
    measure = reach * torch.sin(meridian) * zone.window(meridian)
    held = measure > 0
    return meridian[held], measure[held], (azimuths * passed)[held], GRID[1] * GRID[2] * row[held].int()
