"""Pictures of single tables by the harmonic transport: no library, no samples, and as sharp as the light's texels."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from torchbrdf.brdf import MerlTable
from torchbrdf.lasting import without_autocast
from torchbrdf.light import LightProbe
from torchbrdf.transport.harmonic._polar_grid import PolarGrid
from torchbrdf.transport.harmonic._seen_tables import SeenTable
from torchbrdf.transport.harmonic._table_kernels import EXACT, Detail, reflections
from torchbrdf.transport.harmonic.light import TurningLight
from torchbrdf.transport.harmonic.transport import frequencies_holding, power_of
from torchbrdf.transport.harmonic.views import facing, in_perspective, unsuited
from torchbrdf.view import View

_LOST = 1e-7
"""Share of the light's energy that may be lost in frequencies of azimuth."""

@without_autocast
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
    seen = SeenTable.of(table)
    detail = replace(detail, merged=seen.merged)
    spectra = []
    for probe, rotation in lights:
        turn = rotation if frame is None else frame.T if rotation is None else frame.T.to(rotation) @ rotation
        spectra.append(TurningLight(probe, detail.lines, detail.blur, detail.zones).spectra(turn))
    distance = faced.framing.distance if in_perspective(view) and faced.framing is not None else None
    seen.show(detail, distance)
    grid = PolarGrid(detail.zones, 3 * len(lights), lights[0][0].device)
    for zone, lit in zip(detail.zones, zip(*spectra, strict=True), strict=True):
        light = torch.stack([torch.view_as_real(each).permute(2, 3, 0, 1) for each in lit])  # (L, M, 2, 3, E)
        power = None if light.requires_grad else power_of(light).sum((0, 2, 3))
        contained = light.shape[1] if power is None else frequencies_holding(power.sum(1))
        series = light.new_zeros(len(zone.ring_quadrature[0]), 3 * len(lights), contained, 2)
        for some in reflections(detail, zone, distance):
            rows = slice(some.first_row, some.first_row + some.n_rows)
            needed = min(contained, some.turning)
            if power is not None:
                needed = min(needed, frequencies_holding(power[:, rows].sum(1), _LOST))
            kernels = seen.kernels(zone, some, needed)
            seen_light = light[:, :needed, ..., rows]
            series[some.first : some.first + some.count, :, :needed] = _series(kernels, seen_light)
        grid.add_values(zone, series)
    return view.unpack(grid.seen_by(faced).unflatten(0, (-1, 3)))


def _series(kernels: Sequence[Tensor], light: Tensor) -> Tensor:
    """(G, 3 L, M, 2): real and imaginary parts of the series of G kernels under lights (L, M, 2, 3, E)."""
    lights, m, _, _, e = light.shape
    seen = light.permute(1, 0, 2, 3, 4).reshape(m, -1, e)
    even, *odd = (
        torch.bmm(seen, part.to(light).flatten(2)).view(m, lights, 2, 3, -1, 3).diagonal(dim1=3, dim2=5)
        for part in kernels
    )  # (M, L, 2, G, 3): each channel of the kernels under its own of the light
    if odd:
        even = torch.stack([even[:, :, 0] - odd[0][:, :, 1], even[:, :, 1] + odd[0][:, :, 0]], 2)
    return even.permute(3, 1, 4, 0, 2).flatten(1, 2)
