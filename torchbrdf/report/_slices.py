"""The report's image slices: f_r over theta_h and theta_d, as in Disney's BRDF explorer [Bur12]."""

from math import log2, sqrt

import torch
from torch import Tensor

from torchbrdf.brdf import GRID, MerlTable, above_horizon
from torchbrdf.images import DISPLAY_GAMMA, stops_for
from torchbrdf.report._figures import SURROUND, picture

EXPLANATION = (
    "<p>Image slice: f<sub>r</sub> over θ<sub>h</sub> and θ<sub>d</sub> at φ<sub>d</sub> = 90°, in degrees. The left "
    "edge is the mirror direction, the top edge grazing angles (Fresnel), the bottom edge light from the camera’s "
    "direction. θ<sub>h</sub> is stretched towards the highlight as MERL’s grid is. Stripes: not measured.</p>"
)
"""HTML of what a slice shows."""

_SCALE = 3
"""Pixels along a side of a cell, so that a browser does not blur it."""

_HATCH = (SURROUND - 0.1, SURROUND + 0.1)
"""Display values of the stripes over cells that were not measured."""

_THETA_H_TICKS = (0, 1, 5, 10, 20, 30, 45, 60, 90)
_THETA_D_TICKS = (0, 30, 60, 90)


def slice_values(table: MerlTable) -> tuple[Tensor, Tensor]:
    """f_r (3, 90, 90) in the slice phi_d = 90 degrees and where it was measured (1, 90, 90).

    theta_h grows from left to right with MERL's warp, so that a highlight has room, and theta_d from bottom to top.
    phi_d = 90 degrees lies between two cells: the mean of both, or the measured one. There both directions are above
    the horizon for all theta_h and theta_d; where the cells beside are not, their neighbour's value stands.
    """
    middle = slice(GRID[2] // 2 - 1, GRID[2] // 2 + 1)
    valid = table.valid.cpu()[:, :, middle, None]
    measured = valid.any(2) | ~above_horizon()[:, :, middle, None].any(2)
    weights = torch.where(valid.any(2, keepdim=True), valid, True).double()
    values = table.filled.reshape(*GRID, 3)[:, :, middle].cpu().double()
    mean = (values * weights).sum(2) / weights.sum(2)
    return mean.permute(2, 1, 0).flip(1), measured.permute(2, 1, 0).flip(1)


def slice_exposures(table: MerlTable) -> tuple[float, float]:
    """Two exposures of a slice, powers of two: for what lies beside the highlight, and for the highlight.

    The first is the second of `stops_for`; the second brings the median of the mirror direction to white.
    """
    values = slice_values(table)[0]
    beside = stops_for(values.float())[1]
    peak = float(values[:, :, 0].amax(0).median())
    return beside, min(beside, 2.0 ** round(log2(1 / peak))) if peak > 0 else beside


def slice_figure(table: MerlTable, name: str, exposure: float) -> str:
    """HTML of a table's slice with axes and caption; name is HTML, f_r of 1 / exposure is white."""
    values, measured = (part.repeat_interleave(_SCALE, 1).repeat_interleave(_SCALE, 2) for part in slice_values(table))
    rows, columns = torch.meshgrid(*(torch.arange(n) for n in values.shape[1:]), indexing="ij")
    stripes = torch.where((rows + columns) // (2 * _SCALE) % 2 == 0, *_HATCH) ** DISPLAY_GAMMA / exposure
    white = f"{1 / exposure:g}"
    image = picture(torch.where(measured, values, stripes), f"image slice, white where f_r is {white}", exposure)
    caption = f"{name}{', w' if name else 'W'}hite: f<sub>r</sub> = {white}"
    return f'<figure><div class="slice">{image}{_AXES}</div><figcaption>{caption}</figcaption></figure>'


def _axes() -> str:
    """Ticks around the square from (30, 6) to (210, 186) in which the picture lies, see STYLE."""
    parts = []
    for angle in _THETA_H_TICKS:
        x = 30 + 180 * sqrt(angle / 90)
        parts.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="186" y2="190" class="axis"/>')
        parts.append(f'<text x="{x:.1f}" y="200" class="middle">{angle}</text>')
    for angle in _THETA_D_TICKS:
        y = 186 - 180 * angle / 90
        parts.append(f'<line x1="26" x2="30" y1="{y:.1f}" y2="{y:.1f}" class="axis"/>')
        parts.append(f'<text x="23" y="{y + 3:.1f}" class="end">{angle}</text>')
    parts.append('<text x="120" y="213" class="middle">θ<tspan dy="2">h</tspan></text>')
    parts.append('<text x="8" y="100" class="middle">θ<tspan dy="2">d</tspan></text>')
    return f'<svg viewBox="0 0 216 216" aria-hidden="true">{"".join(parts)}</svg>'


_AXES = _axes()
