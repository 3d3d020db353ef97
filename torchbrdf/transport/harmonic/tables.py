"""Pictures of single tables by the harmonic transport: no library, no samples, and as sharp as the light's texels."""

from collections.abc import Sequence

import torch
from torch import Tensor

from torchbrdf.brdf import MerlTable
from torchbrdf.light import LightProbe
from torchbrdf.transport.harmonic._polar_grid import PolarGrid
from torchbrdf.transport.harmonic._table_kernels import EXACT, Detail, TableKernels, table_kernels
from torchbrdf.transport.harmonic.light import TurningLight
from torchbrdf.transport.harmonic.transport import frequencies_of
from torchbrdf.transport.harmonic.views import facing, in_perspective, unsuited
from torchbrdf.view import View

_SYMMETRIC = 2e-3
"""Relative difference of f_r at phi_d and -phi_d below which one stands for both."""


def table_pictures(
    table: MerlTable, lights: Sequence[tuple[LightProbe, Tensor | None]], view: View, detail: Detail = EXACT
) -> Tensor:
    """(L, 3, H, W) radiance of a view whose material is a table under each light, 0 outside the mask.

    lights  probes on one device, turned by a rotation (3, 3) as `LightProbe.rotated` turns them; None for none
    The kernels of the table, which take most of the time, are the same for all of them. Differentiable in their
    radiance. Raises ValueError for a view that is `unsuited`.
    """
    reason = unsuited(view)
    if reason is not None:
        raise ValueError(f"the harmonic transport cannot render this view: {reason}")
    faced, frame = facing(view)
    coefficients = []
    for probe, rotation in lights:
        turn = rotation if frame is None else frame.T if rotation is None else frame.T.to(rotation) @ rotation
        found = TurningLight(probe, detail.lines, detail.blur, detail.zones).harmonics(turn)
        coefficients.append([part for part, _ in found])
    distance = faced.framing.distance if in_perspective(view) and faced.framing is not None else None
    values, symmetric = table.filled.float().cpu(), _is_symmetric(table)
    grid = PolarGrid(detail.zones, 3 * len(lights), lights[0][0].device)
    for zone, parts in zip(detail.zones, zip(*coefficients, strict=True), strict=True):
        light = torch.stack(parts).unflatten(2, (2, 3))
        contained = frequencies_of(light.transpose(0, 1).flatten(1, -2))
        for rings in zone.groups:
            kernels = table_kernels(values, symmetric, detail, zone, rings, contained, distance)
            grid.add(zone, rings, _series(kernels, light))
    return view.unpack(grid.seen_by(faced).unflatten(0, (-1, 3)))


def _is_symmetric(table: MerlTable) -> bool:
    """Whether f_r is the same at phi_d and -phi_d wherever it was measured."""
    for values, valid in zip(table.values, table.valid, strict=True):
        same = ((values - values.flip(1)).abs() <= _SYMMETRIC * values.abs()).all(-1)
        if not (bool((same | ~valid).all()) and torch.equal(valid, valid.flip(1))):
            return False
    return True


def _series(kernels: TableKernels, light: Tensor) -> Tensor:
    """(G, 3 L, M, 2): real and imaginary parts of the series on a group of rings under lights (L, M, 2, 3, E)."""
    rows = slice(kernels.first_row, kernels.first_row + kernels.n_rows)
    seen = light[:, : kernels.even.shape[1], ..., rows].permute(3, 1, 0, 2, 4).flatten(2, 3)  # (3, M, 2 L, E)
    even, odd = (
        None if part is None else torch.matmul(seen, part.to(light)).unflatten(2, (-1, 2))
        for part in (kernels.even, kernels.odd)
    )
    assert even is not None
    if odd is not None:
        even = torch.stack([even[..., 0, :] - odd[..., 1, :], even[..., 1, :] + odd[..., 0, :]], -2)
    return even.permute(4, 2, 0, 1, 3).flatten(1, 2)
