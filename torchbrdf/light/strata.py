"""A light probe cut into strata with their own points: what the transport draws light directions from.

The strata are rectangles of patches between texels. The whole map is cut again and again along its longer side,
each time at the median of a measure, as the median cut algorithm does [Deb05]; the measure is half power, half
solid angle, so that bright sources and wide dim regions are both cut finely. The points of a stratum follow the
probe's own density, from a jittered square grid of the two random numbers.

Radiance is in units of `unit`, the probe's mean: what follows rounds alike whatever the probe's scale. (In units of a
power of two near the mean a factor of up to two would remain, and half-precision weights would round differently.)
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.images import luminance
from torchbrdf.light._sampling import ImportanceTables
from torchbrdf.light.latlong import bilinear, row_solid_angles
from torchbrdf.light.probe import LightProbe

SIDE = 16
"""Points along a side of a stratum's grid."""

_CUTS = 10
"""From the whole map to a stratum: at most 2^10 strata."""

_MARGIN = 1e-3
"""Radians added to the radius of a stratum for rounding."""


@dataclass(frozen=True)
class LightStrata:
    """K strata in an order that keeps neighbours together, with SIDE x SIDE points each, row by row.

    unit        float           radiance that counts as 1: the luminance of the probe's mean
    directions  (3, K SIDE^2)   unit vectors
    radiance    (3, K SIDE^2)
    density     (K SIDE^2,)     1/sr, of importance sampling of the whole probe
    axis        (3, K)          unit vectors: the middle of each stratum
    radius      (K,)            radians: the points of a stratum lie within this angle of its axis
    share       (K,)            of the power, float64; sums to 1
    texels      (H (W + 1), 4)  radiance and density times sin(theta) at the texels, the first column repeated
    stratum     ((H - 1) W,)    int32, the stratum of every patch
    """

    unit: float
    directions: Tensor
    radiance: Tensor
    density: Tensor
    axis: Tensor
    radius: Tensor
    share: Tensor
    texels: Tensor
    stratum: Tensor
    height: int
    width: int

    @classmethod
    def build(cls, probe: LightProbe, generator: torch.Generator) -> "LightStrata":
        """Strata of a probe, on its device; the generator (on the CPU) places the points."""
        unit = float(luminance(probe.mean_radiance.detach()))
        light = probe.radiance.detach() / unit
        tables = ImportanceTables.build(light)
        power = _patch_power(tables)
        rectangles, share = _cut(power)
        directions, density = _draw(tables, power, rectangles, generator)
        axis = torch.nn.functional.normalize(directions.mean(1), dim=-1)
        nearest = (directions * axis[:, None]).sum(-1).amin(1)
        directions = directions.reshape(-1, 3)
        return cls(
            unit=unit,
            directions=directions.T.contiguous(),
            radiance=bilinear(light, directions).T.contiguous(),
            density=density.reshape(-1),
            axis=axis.T.contiguous(),
            radius=torch.acos(nearest.clamp(-1, 1)) + _MARGIN,
            share=share,
            texels=_texels(light, tables),
            stratum=_strata_of_patches(rectangles, power),
            height=tables.height,
            width=tables.width,
        )

    def __len__(self) -> int:
        """The number of strata K."""
        return len(self.share)

    def seen(self, w_i: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Radiance (3, ...), density (...) in 1/sr and stratum (...) in unit directions w_i (3, ...).

        Both follow from the same four texels, so that dim radiance beside bright keeps its ratio to the density.
        """
        sin_theta = torch.sqrt((w_i[0] * w_i[0]).addcmul_(w_i[2], w_i[2]))
        y = torch.atan2(sin_theta, w_i[1]).mul_((self.height - 1) / math.pi)
        x = torch.atan2(w_i[0], -w_i[2]).mul_(0.5 * self.width / math.pi).sub_(0.5)
        x = torch.where(x < 0, x + self.width, x)
        column = x.to(torch.int32).clamp_(0, self.width - 1)
        row = y.to(torch.int32).clamp_(0, self.height - 2)
        s, t = x.sub_(column), y.sub_(row).clamp_(0, 1)
        s_0, t_0 = 1 - s, 1 - t
        patch = torch.add(column, row, alpha=self.width)
        below = self.width + 1
        corners = torch.tensor([0, 1, below, below + 1], dtype=torch.int32, device=w_i.device)
        values = torch.nn.functional.embedding_bag(
            torch.add(column, row, alpha=below).reshape(-1, 1) + corners,
            self.texels,
            per_sample_weights=torch.stack([s_0 * t_0, s * t_0, s_0 * t, s * t], -1).reshape(-1, 4),
            mode="sum",
        ).T.reshape(4, *s.shape)
        stratum = self.stratum.index_select(0, patch.reshape(-1)).view(s.shape)
        return values[:3], values[3] / sin_theta.clamp_min_(1e-7), stratum


def _patch_power(tables: ImportanceTables) -> Tensor:
    """(H - 1, W) float64: the share of the power of each patch between four texels."""
    power = tables.corners.double().mean(-1).reshape(tables.height - 1, tables.width)
    return power / power.sum()


def _texels(light: Tensor, tables: ImportanceTables) -> Tensor:
    corners = tables.corners.reshape(tables.height - 1, tables.width, 4)
    density = torch.cat([corners[..., 0], corners[-1:, :, 2]])
    texels = torch.cat([light.permute(1, 2, 0), density[..., None]], -1)
    return torch.cat([texels, texels[:, :1]], 1).reshape(-1, 4)


def _strata_of_patches(rectangles: Tensor, power: Tensor) -> Tensor:
    """((H - 1) W,) int32; patches without power have density 0 and may name any stratum."""
    stratum = torch.zeros(power.shape, dtype=torch.int32)
    for i, (top, bottom, left, right) in enumerate(rectangles.tolist()):
        stratum[top:bottom, left:right] = i
    return stratum.reshape(-1).to(power.device)


def _summed(measure: Tensor) -> Tensor:
    """(H, W + 1): the sum of a measure (H - 1, W) over all patches above and to the left of each corner."""
    return torch.nn.functional.pad(measure, (1, 0, 1, 0)).cumsum(0).cumsum(1)


def _over(summed: Tensor, top: Tensor, bottom: Tensor, left: Tensor, right: Tensor) -> Tensor:
    return summed[bottom, right] - summed[top, right] - summed[bottom, left] + summed[top, left]


def _cut(power: Tensor) -> tuple[Tensor, Tensor]:
    """Rectangles (K, 4) int64 of patches (top, bottom, left, right; ends excluded) and their power (K,)."""
    rows, columns = power.shape
    angles = row_solid_angles(rows + 1, columns, power.device)
    area = (angles[:-1] + angles[1:])[:, None] * (power > 0)
    measure = _summed(power + area / area.sum())
    row_step, column_step = math.pi / rows, 2 * math.pi / columns
    nodes = torch.tensor([[0, rows, 0, columns]], device=power.device)
    for _ in range(_CUTS):
        top, bottom, left, right = nodes.unbind(1)
        tall = (bottom - top).float() * row_step
        wide = (right - left).float() * column_step * torch.sin((top + bottom).float() * (row_step / 2))
        by_row = ((tall >= wide) | (right - left == 1)) & (bottom - top > 1)
        whole = (bottom - top == 1) & (right - left == 1)
        at = _median(measure, nodes, by_row)
        first = torch.stack([top, torch.where(by_row, at, bottom), left, torch.where(by_row, right, at)], 1)
        second = torch.stack([torch.where(by_row, at, top), bottom, torch.where(by_row, left, at), right], 1)
        halves = torch.stack([torch.where(whole[:, None], nodes, first), second], 1)
        nodes = halves[torch.stack([torch.ones_like(whole), ~whole], 1)]
    share = _over(_summed(power), *nodes.unbind(1)).clamp_min(0)
    lit = share > 0
    return nodes[lit], share[lit] / share[lit].sum()


def _median(summed: Tensor, nodes: Tensor, by_row: Tensor) -> Tensor:
    """(N,): the row (or column) of patches at which a cut leaves about half of the measure on either side."""
    top, bottom, left, right = nodes.unbind(1)
    half = _over(summed, top, bottom, left, right) / 2
    low = torch.where(by_row, top, left) + 1
    high = torch.maximum(low, torch.where(by_row, bottom, right) - 1)
    for _ in range(int((high - low).max()).bit_length()):
        middle = (low + high) // 2
        before = _over(summed, top, torch.where(by_row, middle, bottom), left, torch.where(by_row, right, middle))
        low, high = torch.where(before < half, middle + 1, low), torch.where(before < half, high, middle)
        low = torch.minimum(low, high)
    return low


def _draw(
    tables: ImportanceTables, power: Tensor, rectangles: Tensor, generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """The points of the strata: directions (K, SIDE^2, 3) and their densities (K, SIDE^2) in 1/sr."""
    k = len(rectangles)
    jitter = torch.rand(k, SIDE, SIDE, 2, generator=generator, dtype=torch.float64)
    cell = torch.arange(SIDE, dtype=torch.float64)
    grid = torch.stack(torch.meshgrid(cell, cell, indexing="ij"), -1)
    u, v = ((grid + jitter) / SIDE).to(power.device).flatten(1, 2).unbind(-1)
    row, v_rest = _rows(power, rectangles, u)
    column, w_rest = _columns(power, rectangles, row, v)
    directions, density = tables.place(*(each.reshape(-1) for each in (row, column, v_rest, w_rest)))
    return directions.reshape(k, -1, 3), density.reshape(k, -1)


def _rows(power: Tensor, rectangles: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """The rows (K, N) of rectangles (K, 4) above which the share u (K, N) of their power lies, and the rest of u."""
    top, bottom, left, right = rectangles[..., None].unbind(1)
    edges = torch.minimum(top + torch.arange(int((bottom - top).max()) + 1, device=power.device), bottom)
    start, rows = edges * (power.shape[1] + 1), _summed(power).ravel()
    above = rows[start + right] - rows[start + left]
    target = torch.lerp(above[:, :1], above[:, -1:], u)
    step = torch.searchsorted(above, target, right=True) - 1
    step = torch.minimum(step.clamp_min(0), bottom - top - 1)
    return top + step, _rest(target, above.gather(1, step), above.gather(1, step + 1))


def _columns(power: Tensor, rectangles: Tensor, row: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
    """The columns (K, N) of rows (K, N) left of which the share v of the power in the rectangle lies, the rest of v.

    All rows are searched at once, each as its number and the share of its own power before a column.
    """
    left, right = rectangles[:, 2:3], rectangles[:, 3:]
    start = row * (power.shape[1] + 1)
    before = torch.nn.functional.pad(power, (1, 0)).cumsum(1)
    whole = before[:, -1:]
    numbers = torch.arange(len(power), dtype=power.dtype, device=power.device)
    ordered = (numbers[:, None] + before / torch.where(whole > 0, whole, 1)).ravel()
    target = torch.lerp(ordered[start + left], ordered[start + right], v)
    column = torch.searchsorted(ordered, target, right=True) - 1 - start
    column = torch.minimum(torch.maximum(column, left), right - 1)
    return column, _rest(target, ordered[start + column], ordered[start + column + 1])


def _rest(target: Tensor, begin: Tensor, end: Tensor) -> Tensor:
    """How far a target lies between two values, from 0 to 1 without them."""
    rest = torch.where(end > begin, (target - begin) / (end - begin), 0.5)
    return rest.float().clamp(1e-7, 1 - 1e-7)
