"""Importance sampling of a lat-long light probe, in proportion to its bilinear luminance.

The density over (phi, theta) is bilinear between texels, with the value luminance * solid angle / (hat area
in phi and theta) at each: it follows luminance * sin theta, sums exactly to the integral of the luminance,
and at the poles is a third of a row's sine instead of zero, so that light at a pole is still found.
A sample picks a row of patches, then a patch in it, by their exact sums; what is left of the two random
numbers places it inside by inverting first the linear marginal in theta, then the linear conditional in phi.
Where the luminance is zero the density is zero, and such patches are never picked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.images import luminance
from torchbrdf.light.latlong import CPU_CHUNK, patch_of, row_solid_angles, texel_coordinates

_TINY = 1e-30


@dataclass(frozen=True)
class ImportanceTables:
    """What sampling needs of one probe; `build` makes it."""

    height: int
    width: int
    corners: Tensor  # ((H - 1) W, 4) float32: the density at a patch's corners (s, t) = 00, 10, 01, 11
    row_edges: Tensor  # (H,) float64: cumulative share of the rows of patches
    column_edges: Tensor  # ((H - 1) (W + 1),) float64: cumulative share of a row's patches, from 0 to 1
    row_guide: Tensor  # (G,) int64: the patch row in which g / G falls
    column_guide: Tensor  # ((H - 1) W,) int64: in each row, the patch in which c / W falls

    @staticmethod
    def build(radiance: Tensor) -> ImportanceTables:
        """The tables of `radiance` (3, H, W), on its device; no gradient flows through them."""
        _, height, width = radiance.shape
        device = radiance.device
        hats = row_solid_angles(height, width, device)
        share = luminance(radiance.detach().double()) * hats[:, None]
        share = share / share.sum()
        area = (2 * math.pi / width) * (math.pi / (height - 1))
        density = share / area
        density[0] *= 2  # the poles' hats are half as wide
        density[-1] *= 2
        right = torch.roll(density, -1, dims=1)
        corners = torch.stack([density[:-1], right[:-1], density[1:], right[1:]], dim=-1)

        patches = corners.mean(dim=-1)
        columns = torch.cumsum(torch.nn.functional.pad(patches, (1, 0)), dim=1)
        rows = torch.cumsum(torch.nn.functional.pad(columns[:, -1], (1, 0)), dim=0)
        column_edges = columns / columns[:, -1:].clamp_min(torch.finfo(torch.float64).tiny)
        column_edges[columns[:, -1] == 0, -1] = 1.0  # rows without light are never picked
        row_edges = rows / rows[-1]

        n_guide = 8 * height
        steps = torch.arange(n_guide, dtype=torch.float64, device=device) / n_guide
        row_guide = torch.searchsorted(row_edges, steps, right=True) - 1
        steps = (torch.arange(width, dtype=torch.float64, device=device) / width).expand(height - 1, width)
        column_guide = torch.searchsorted(column_edges, steps.contiguous(), right=True) - 1
        return ImportanceTables(
            height, width, corners.reshape(-1, 4).float(), row_edges, column_edges.reshape(-1), row_guide,
            column_guide.reshape(-1),
        )

    def sample(self, u: Tensor) -> tuple[Tensor, Tensor]:
        """Directions (P, 3) float32 and their densities (P,) in 1/sr, for u (P, 2) in [0, 1)."""
        directions = torch.empty(len(u), 3, device=u.device, dtype=torch.float32)
        pdf = torch.empty(len(u), device=u.device, dtype=torch.float32)
        step = len(u) if u.is_cuda else CPU_CHUNK
        for start in range(0, len(u), max(step, 1)):
            chunk = slice(start, start + step)
            self._sample_into(u[chunk], directions[chunk], pdf[chunk])
        return directions, pdf

    def pdf(self, directions: Tensor) -> Tensor:
        """The density (P,) in 1/sr with which `sample` returns unit directions (P, 3)."""
        pdf = torch.empty(len(directions), device=directions.device, dtype=torch.float32)
        step = len(directions) if directions.is_cuda else CPU_CHUNK
        for start in range(0, len(directions), max(step, 1)):
            chunk = slice(start, start + step)
            x, y, sin_theta = texel_coordinates(directions[chunk].float(), self.height, self.width)
            column, row, s, t = patch_of(x, y, self.height, self.width)
            upper, lower = self._at_column(row * self.width + column, s)
            pdf[chunk] = torch.lerp(upper, lower, t) / sin_theta.clamp_min(1e-7)
        return pdf

    def _sample_into(self, u: Tensor, directions: Tensor, pdf: Tensor) -> None:
        u = u.double().clamp(0.0, 1 - 2.0**-53)
        row, v = _find(self.row_edges, self.row_guide, u[:, 0], None, self.height - 1)
        column, w = _find(self.column_edges, self.column_guide, u[:, 1], row, self.width)
        placed = self.place(row, column, v, w)
        directions.copy_(placed[0])
        pdf.copy_(placed[1])

    def place(self, row: Tensor, column: Tensor, v: Tensor, w: Tensor) -> tuple[Tensor, Tensor]:
        """Directions (P, 3) inside patches, and the densities (P,) with which `sample` returns them, in 1/sr.

        row, column  (P,)  int64, the patch
        v, w         (P,)  float32 in (0, 1): shares of the patch's density, in theta and in phi
        """
        c00, c10, c01, c11 = self.corners.index_select(0, row * self.width + column).unbind(-1)
        t = _invert_linear(c00 + c10, c01 + c11, v)
        upper, lower = torch.lerp(c00, c01, t), torch.lerp(c10, c11, t)
        s = _invert_linear(upper, lower, w)
        theta = (row + t) * (math.pi / (self.height - 1))
        phi = (column + s + 0.5) * (2 * math.pi / self.width)
        sin_theta = torch.sin(theta)
        directions = torch.stack([torch.sin(phi) * sin_theta, torch.cos(theta), -torch.cos(phi) * sin_theta], -1)
        return directions, torch.lerp(upper, lower, s) / sin_theta.clamp_min(1e-7)

    def _at_column(self, patch: Tensor, s: Tensor) -> tuple[Tensor, Tensor]:
        c00, c10, c01, c11 = self.corners.index_select(0, patch).unbind(-1)
        return torch.lerp(c00, c10, s), torch.lerp(c01, c11, s)


def _find(edges: Tensor, guide: Tensor, u: Tensor, block: Tensor | None, n: int) -> tuple[Tensor, Tensor]:
    """The interval k of n with edges[k] <= u < edges[k + 1], in the given block of a blocked table, and what
    is left of u, as a new number in (0, 1), float32.

    The guide gives the first candidate and two steps find nearly all; the rest go to a binary search.
    """
    n_guide = n if block is not None else len(guide)
    bucket = (u * n_guide).long()
    first_edge = torch.zeros_like(bucket)
    if block is not None:
        bucket += block * n_guide
        first_edge = block * (n + 1)
    at = guide.index_select(0, bucket) + first_edge
    for _ in range(2):
        at += edges.index_select(0, at + 1) <= u
    late = (edges.index_select(0, at + 1) <= u).nonzero().squeeze(1)
    if len(late) > 0:
        at[late] = _bisect(edges, u[late], at[late], first_edge[late] + n)
    low, high = edges.index_select(0, at), edges.index_select(0, at + 1)
    rest = ((u - low) / (high - low)).float().clamp(1e-7, 1 - 1e-7)
    return at - first_edge, rest


def _bisect(edges: Tensor, u: Tensor, low: Tensor, high: Tensor) -> Tensor:
    """The last index in [low, high) whose edge is <= u."""
    for _ in range(int((high - low).max()).bit_length()):
        middle = (low + high) // 2
        right = edges.index_select(0, middle) <= u
        low, high = torch.where(right, middle, low), torch.where(right, high, middle)
    return low


def _invert_linear(a: Tensor, b: Tensor, u: Tensor) -> Tensor:
    """t in [0, 1] at which the density (1 - t) a + t b, up to scale, has the cumulative share u."""
    root = torch.sqrt(torch.lerp(a * a, b * b, u))
    return (u * (a + b) / (a + root).clamp_min(_TINY)).clamp(0.0, 1.0)
