"""A light probe cut into strata, each with its own points: what the transport draws light directions from.

The strata are rectangles of patches between texels, found by cutting the map again and again at the median of a
measure along its longer side, as the median cut algorithm does [Deb05]. The measure is half power, half solid
angle, so that bright sources and wide dim regions are both cut finely. Within a stratum a fixed set of points,
jittered on a square grid of the two random numbers, follows the probe's own importance sampling.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.latlong import bilinear, directions_at, row_solid_angles
from torchbrdf.probe import LightProbe
from torchbrdf.probe_sampling import ImportanceTables

_LEVELS = 10
"""Cuts from the whole map to a stratum: at most 2^10 strata."""

GRID = 16
"""Points along a side of a stratum's grid."""


@dataclass(frozen=True)
class LightStrata:
    """K strata with GRID x GRID points each.

    directions  (K GRID^2, 3)  unit vectors
    emission    (K GRID^2, 3)  radiance / density, sr times radiance: its mean over a stratum's points is the
                               irradiance at normal incidence from that stratum
    axis        (K, 3)         unit vectors: the middle of each stratum
    radius      (K,)           radians: the points of a stratum lie within this angle of its axis
    share       (K,)           of the power, float64; sums to 1
    """

    directions: Tensor
    emission: Tensor
    axis: Tensor
    radius: Tensor
    share: Tensor

    @classmethod
    def build(cls, probe: LightProbe, generator: torch.Generator) -> "LightStrata":
        """Strata of a probe; the generator (on the CPU) places the points."""
        tables = ImportanceTables.build(probe.radiance)
        power = _patch_power(tables)
        rectangles, share = _cut(power)
        u = torch.rand(len(rectangles), GRID, GRID, 2, generator=generator, dtype=torch.float64)
        cell = torch.arange(GRID, dtype=torch.float64)
        u[..., 0] += cell[:, None]
        u[..., 1] += cell
        directions, density = _draw(tables, power, rectangles, (u / GRID).to(probe.device))
        radiance = bilinear(probe.radiance.detach(), directions)
        emission = radiance * torch.where(density > 0, share[:, None].float() / density, 0)[..., None]
        axis = torch.nn.functional.normalize(directions.mean(1), dim=-1)
        nearest = (directions * axis[:, None]).sum(-1).amin(1)
        return cls(
            directions.reshape(-1, 3), emission.reshape(-1, 3), axis, torch.acos(nearest.clamp(-1, 1)) + 1e-3, share
        )


def _patch_power(tables: ImportanceTables) -> Tensor:
    """(H - 1, W) float64: the share of the power of each patch between four texels."""
    power = tables.corners.double().mean(-1).reshape(tables.height - 1, tables.width)
    return power / power.sum()


def _summed(measure: Tensor) -> Tensor:
    """(H, W + 1): the sum of a measure (H - 1, W) over all patches above and to the left of each corner."""
    return torch.nn.functional.pad(measure, (1, 0, 1, 0)).cumsum(0).cumsum(1)


def _over(summed: Tensor, top: Tensor, bottom: Tensor, left: Tensor, right: Tensor) -> Tensor:
    return summed[bottom, right] - summed[top, right] - summed[bottom, left] + summed[top, left]


def _cut(power: Tensor) -> tuple[Tensor, Tensor]:
    """Rectangles (K, 4) int64 of patches (top, bottom, left, right; ends excluded) and their power (K,)."""
    rows, columns = power.shape
    angles = row_solid_angles(rows + 1, columns, power.device)
    area = ((angles[:-1] + angles[1:]) / 2)[:, None] * (power > 0)
    measure = _summed(power + area / area.sum())
    row_step, column_step = math.pi / rows, 2 * math.pi / columns
    nodes = torch.tensor([[0, rows, 0, columns]], device=power.device)
    for _ in range(_LEVELS):
        top, bottom, left, right = nodes.unbind(1)
        tall = (bottom - top) * row_step
        wide = (right - left) * column_step * torch.sin((top + bottom) * (row_step / 2))
        whole = (bottom - top == 1) & (right - left == 1)
        by_row = ((tall >= wide) | (right - left == 1)) & (bottom - top > 1)
        at = _median(measure, nodes, by_row)
        first = torch.stack([top, torch.where(by_row, at, bottom), left, torch.where(by_row, right, at)], 1)
        second = torch.stack([torch.where(by_row, at, top), bottom, torch.where(by_row, left, at), right], 1)
        nodes = torch.cat([torch.where(whole[:, None], nodes, first), second[~whole]])
    share = _over(_summed(power), *nodes.unbind(1)).clamp_min(0)
    lit = share > 0
    return nodes[lit], share[lit] / share[lit].sum()


def _median(summed: Tensor, nodes: Tensor, by_row: Tensor) -> Tensor:
    """(N,): the row (or column) of patches at which a cut leaves half of the measure on either side."""
    top, bottom, left, right = nodes.unbind(1)
    half = _over(summed, top, bottom, left, right) / 2
    low, high = torch.where(by_row, top, left) + 1, torch.where(by_row, bottom, right) - 1
    high = torch.maximum(low, high)
    for _ in range(int((high - low).max()).bit_length()):
        middle = (low + high) // 2
        before = _over(summed, top, torch.where(by_row, middle, bottom), left, torch.where(by_row, right, middle))
        low, high = torch.where(before < half, middle + 1, low), torch.where(before < half, high, middle)
        low = torch.minimum(low, high)
    return low


def _draw(tables: ImportanceTables, power: Tensor, rectangles: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Directions (K, G^2, 3) and their densities (K, G^2) over solid angle of the whole probe.

    u  (K, G, G, 2)  float64 in [0, 1)
    """
    k = len(rectangles)
    top, bottom, left, right = (edge[:, None].expand(k, GRID * GRID).reshape(-1) for edge in rectangles.unbind(1))
    u, v = u.reshape(-1, 2).unbind(1)
    summed = _summed(power)
    row, v_rest = _bisect(lambda r: summed[r, right] - summed[r, left], top, bottom, u)
    along = torch.nn.functional.pad(power, (1, 0)).cumsum(1)
    column, w_rest = _bisect(lambda c: along[row, c], left, right, v)
    directions, density = tables.place(row, column, v_rest, w_rest)
    return directions.reshape(k, -1, 3), density.reshape(k, -1)


def _bisect(cumulative, low: Tensor, high: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """The interval (N,) of [low, high) in which the share u of a cumulative function falls, and what is left of u."""
    begin, end = cumulative(low), cumulative(high)
    target = begin + u * (end - begin)
    for _ in range(int((high - low).max()).bit_length()):
        middle = (low + high) // 2
        right = cumulative(middle) <= target
        low, high = torch.where(right, middle, low), torch.where(right, high, middle)
    begin, end = cumulative(low), cumulative(low + 1)
    return low, ((target - begin) / (end - begin)).float().clamp(1e-7, 1 - 1e-7)
