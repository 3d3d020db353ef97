"""Pictures of single tables by the harmonic transport: no library, no samples, and as sharp as the light's texels.

The kernels of a table take a second, so nothing is kept. The radiance on the rings of all zones is summed as a Fourier
series over azimuth and brought onto one polar grid of normals, from which a view averages over its pixels.
"""

from collections.abc import Sequence
from math import pi, radians

import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from torchbrdf.brdf import GRID, MerlTable
from torchbrdf.light import LightProbe
from torchbrdf.transport.harmonic._table_kernels import TableKernels, table_kernels, table_zones
from torchbrdf.transport.harmonic.grid import Zone
from torchbrdf.transport.harmonic.light import TurningLight
from torchbrdf.transport.harmonic.splines import SUPPORT
from torchbrdf.transport.harmonic.transport import frequencies_of
from torchbrdf.transport.harmonic.views import facing, in_perspective, unsuited
from torchbrdf.view import View

_LINES = 1152
_BLUR = radians(0.025)
"""Of the light, see `TurningLight`."""

_PER_INTERVAL = 2
"""Rows of the polar grid between two rings of the finest zone."""

_PLACES = 4
"""Places around the polar grid for each of its highest frequency."""

_SPACING = 2e-3
"""Between points inside a pixel, on the disc of a sphere of radius 1, of normals half way to the mirrored direction."""

_POINTS = (2, 4, 6, 8, 12, 16, 24)
"""Points along a side of a pixel that are used."""

_POINTS_AT_ONCE = 1 << 20

_SYMMETRIC = 2e-3
"""Relative difference of f_r at phi_d and -phi_d below which both count as their mean."""


def table_images(tables: Sequence[MerlTable], probe: LightProbe, view: View) -> Tensor:
    """(K, 3, H, W) radiance of a view whose material is each of K tables, 0 outside the mask.

    On the probe's device; differentiable in its radiance. Raises ValueError for a view that is `unsuited`.
    """
    reason = unsuited(view)
    if reason is not None:
        raise ValueError(f"the harmonic transport cannot render this view: {reason}")
    faced, frame = facing(view)
    light = TurningLight(probe, _LINES, _BLUR, table_zones())
    coefficients = [part for part, _ in light.harmonics(None if frame is None else frame.T)]
    distance = faced.framing.distance if in_perspective(view) and faced.framing is not None else None
    radiance = _polar_radiance(tables, coefficients, distance)
    packed = _pixels(radiance, faced)
    return view.unpack(packed.unflatten(0, (len(tables), 3)))


def _polar_radiance(tables: Sequence[MerlTable], light: Sequence[Tensor], distance: float | None) -> Tensor:
    """(3 K, H, A + 1): radiance on H polar angles of normals and A azimuths, of which the first is repeated at the end.

    light  (M, 6, elevations) of every zone: real parts of R, G and B, then imaginary
    """
    device = light[0].device
    values = torch.stack([table.filled.float().cpu() for table in tables], 2).flatten(1)  # (cells, 3 K)
    symmetric = all(_is_symmetric(table) for table in tables)
    zones = table_zones()
    places = _PLACES * zones[0].rows
    gamma = _polar_rows(zones[0])
    series = torch.zeros(len(gamma), 3, zones[0].frequencies, len(tables), 2, device=device)
    for zone, coefficients in zip(zones, light, strict=True):
        contained = frequencies_of(coefficients)
        for rings in zone.groups:
            kernels = table_kernels(values, symmetric, zone, rings, contained, distance)
            found = _series(kernels, coefficients.unflatten(1, (2, 3)), len(rings))
            rows, to_rows = _to_rows(zone, rings, gamma)
            n = found.shape[2]
            series[rows, :, :n] += (to_rows.to(device) @ found.flatten(1)).view(-1, *found.shape[1:])
    frequency = torch.arange(zones[0].frequencies, device=device)
    interpolated = torch.sinc(frequency / places).square()[:, None]  # what linear interpolation between places costs
    waves = torch.view_as_complex(series) / interpolated
    radiance = torch.fft.irfft(waves, n=places, dim=2, norm="forward").permute(3, 1, 0, 2).flatten(0, 1)
    return torch.cat([radiance, radiance[..., :1]], -1)


def _is_symmetric(table: MerlTable) -> bool:
    """Whether f_r is the same at phi_d and -phi_d wherever it was measured."""
    values, mirrored = table.values, table.values.flip(2)
    same = ((values - mirrored).abs() <= _SYMMETRIC * values.abs()).all(-1)
    return bool((same | ~table.valid).all()) and torch.equal(table.valid, table.valid.flip(2))


def _series(kernels: TableKernels, light: Tensor, n_rings: int) -> Tensor:
    """(G, 3, M, K, 2): real and imaginary parts of the series over azimuth of the radiance on a group of rings."""
    rows = slice(kernels.first_row, kernels.first_row + kernels.n_rows)
    seen = light[: kernels.even.shape[1], :, :, rows].permute(2, 0, 1, 3)  # (3, M, 2, E)
    even, odd = (
        None if part is None else torch.matmul(seen, part.to(light).unflatten(2, (kernels.n_rows, -1)))
        for part in (kernels.even, kernels.odd)
    )
    real, imaginary = even.unbind(2)
    if odd is not None:
        real, imaginary = real - odd[:, :, 1], imaginary + odd[:, :, 0]
    return torch.stack([real, imaginary], -1).unflatten(2, (n_rings, -1)).permute(2, 0, 1, 3, 4)


def _polar_rows(zone: Zone) -> Tensor:
    """(H,) float64: the polar grid's angles, as far apart as rings are."""
    return zone.ring_angle(torch.arange(_PER_INTERVAL * zone.intervals + 1, dtype=torch.float64) / _PER_INTERVAL)


def _to_rows(zone: Zone, rings: range, gamma: Tensor) -> tuple[slice, Tensor]:
    """The rows of the polar grid that a group of rings reaches, and what turns its moments into values there."""
    dual = zone.ring_dual[:, rings.start : rings.stop]
    first, weights = zone.ring_splines(gamma)
    values = torch.einsum("hk,hkg->hg", weights, dual[first[:, None] + torch.arange(SUPPORT)]).float()
    touched = torch.nonzero(values.abs().amax(1) > 0).ravel()
    rows = slice(int(touched[0]), int(touched[-1]) + 1)
    return rows, values[rows]


def _pixels(radiance: Tensor, view: View) -> Tensor:
    """(3 K, P): averages over the area of each pixel."""
    pixels = view.pixels.cpu()
    packed = radiance.new_zeros(len(radiance), len(pixels))
    points = _points_of(view, pixels)
    for n in points.unique().tolist():
        for some in torch.nonzero(points == n).ravel().split(max(1, _POINTS_AT_ONCE // n**2)):
            at = (torch.arange(n) + 0.5) / n
            places, lit = _places(view, pixels[some], at, radiance.shape)
            seen = grid_sample(radiance[None], places[None].to(radiance), mode="bilinear", align_corners=True)[0]
            share = lit.to(radiance) / n**2  # a normal that faces away is dark
            packed[:, some.to(packed.device)] = torch.einsum("cqs,qs->cq", seen, share)
    return packed


def _points_of(view: View, pixels: Tensor) -> Tensor:
    """(P,) int64: how many points along a side of each pixel."""
    normals = _inside(view, pixels, torch.tensor([0.02, 0.5, 0.98]))[0]
    reach = 2 * (normals - normals[..., 4:5])[:2].norm(dim=0).amax(1)
    counts = torch.tensor(_POINTS)
    return counts[torch.bucketize(reach / _SPACING, counts).clamp_max(len(counts) - 1)]


def _inside(view: View, pixels: Tensor, at: Tensor) -> tuple[Tensor, Tensor]:
    """Normals and view directions (3, P, n n) at a grid of n x n places inside pixels."""
    v, u = (axis.reshape(1, -1).expand(len(pixels), -1) for axis in torch.meshgrid(at, at, indexing="ij"))
    points = view.surface(pixels, u, v)
    return points.normals, points.view_dirs


def _places(view: View, pixels: Tensor, at: Tensor, shape: torch.Size) -> tuple[Tensor, Tensor]:
    """(P, n n, 2): where `grid_sample` finds the points of pixels; and which are not turned away."""
    (x, y, z), toward = _inside(view, pixels, at)
    gamma = torch.atan2(torch.hypot(x, y), z)
    if in_perspective(view):
        gamma = gamma + torch.atan2(torch.hypot(toward[0], toward[1]), toward[2]) / 2
    _, height, width = shape
    row = _PER_INTERVAL * table_zones()[0].ring_coordinate(gamma.clamp(0, pi / 2)).to(gamma)
    column = torch.remainder(torch.atan2(y, x) * ((width - 1) / (2 * pi)), width - 1)
    return torch.stack([column * (2 / (width - 1)) - 1, row * (2 / (height - 1)) - 1], -1), z > 0
