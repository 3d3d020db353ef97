"""The default light probe: a studio room, computed from direction functions, no file.

It is made for inverse rendering: over five decades of radiance, sharp edges, and light of several sizes and
colours from all sides (in front, behind, above and below), so that materials of every gloss look different.
"""

import math
from dataclasses import astuple, dataclass
from functools import lru_cache

import torch
from torch import Tensor

from torchbrdf.lasting import lasting, on_disk
from torchbrdf.light.latlong import area_mean

_SAMPLES_PER_PI = 640  # sub-samples from pole to pole: lamps keep their energy at every height
# The camera is the origin of a room of 8 x 4 x 7 metres: left, right, floor, ceiling, front (-Z), back.
_WALLS = torch.tensor([-4.2, 3.8, -1.5, 2.5, -3.2, 3.8], dtype=torch.float32)


@dataclass(frozen=True)
class _Panel:
    """A rectangle on a wall: `axis` 0, 1, 2 (X, Y, Z) with `sign` says which, centre and half sizes in metres
    along the two other axes in order; `bars` window panes along each, separated by dark mullions."""

    axis: int
    sign: int
    centre: tuple[float, float]
    half: tuple[float, float]
    radiance: tuple[float, float, float]
    bars: tuple[int, int] = (1, 1)


_PANELS = (
    _Panel(0, -1, (0.6, -0.6), (1.0, 1.7), (9.0, 13.0, 20.0), bars=(2, 4)),  # window, left: blue sky
    _Panel(2, -1, (-0.2, 0.9), (1.2, 0.6), (3.2, 2.8, 2.2), bars=(3, 1)),  # window, front: overcast
    _Panel(0, 1, (0.5, 1.2), (0.9, 0.9), (15.0, 11.0, 7.0)),  # softbox, right
    _Panel(2, 1, (1.9, 0.3), (0.08, 1.3), (60.0, 66.0, 75.0)),  # strip light, behind
    _Panel(2, 1, (-1.6, -0.2), (0.8, 1.2), (0.9, 0.06, 0.04)),  # red cloth, behind
    _Panel(0, 1, (-0.2, -1.9), (1.1, 0.8), (0.05, 0.5, 0.12)),  # green screen, right
    _Panel(1, 1, (0.8, 0.5), (0.35, 1.4), (26.0, 26.0, 24.0), bars=(1, 3)),  # ceiling tubes
    _Panel(1, -1, (-1.3, 1.6), (0.5, 0.5), (2.5, 1.2, 4.5)),  # violet light box on the floor
    _Panel(1, -1, (1.5, -1.7), (0.3, 0.6), (1.6, 4.0, 4.2)),  # turquoise light box on the floor
)

# Direction towards it, angular radius in degrees, radiance.
_LAMPS = (
    ((0.45, 0.62, -0.55), 1.8, (2600.0, 2250.0, 1750.0)),  # spotlight, front right, high
    ((-0.55, 0.70, 0.62), 2.6, (300.0, 380.0, 560.0)),  # blue lamp, behind left, high
    ((0.75, -0.42, 0.60), 2.2, (420.0, 210.0, 60.0)),  # amber lamp, behind right, low
    ((-0.38, -0.75, -0.50), 2.0, (60.0, 260.0, 150.0)),  # green floor spot, front left, below
    ((0.05, 0.33, -0.95), 1.2, (700.0, 90.0, 60.0)),  # red point, front
)


@lru_cache(maxsize=4)
@lasting
def studio_room(height: int) -> Tensor:
    """Radiance (3, height, 2 height) of the default light probe; not to be written to."""

    def made() -> dict[str, Tensor]:
        return {"radiance": area_mean(_radiance, height, 2 * height, max(3, math.ceil(_SAMPLES_PER_PI / height)))}

    scene = [_SAMPLES_PER_PI, _WALLS.tolist(), [astuple(panel) for panel in _PANELS], _LAMPS]
    return on_disk("lights", [height, scene], made)["radiance"]


def _radiance(directions: Tensor) -> Tensor:
    """Radiance (..., 3) that arrives at the middle of the room from unit directions (..., 3)."""
    reach = (torch.where(directions < 0, _WALLS[0::2], _WALLS[1::2]) / directions).abs()
    distance, axis = reach.min(dim=-1)
    point = directions * distance[..., None]
    sign = torch.where(directions.gather(-1, axis[..., None])[..., 0] < 0, -1, 1)
    radiance = _room(point, axis, sign)
    for panel in _PANELS:
        radiance = _add_panel(radiance, panel, point, (axis == panel.axis) & (sign == panel.sign))
    for towards, degrees, colour in _LAMPS:
        centre = torch.nn.functional.normalize(directions.new_tensor(towards), dim=0)
        inside = directions @ centre > math.cos(math.radians(degrees))
        radiance = torch.where(inside[..., None], directions.new_tensor(colour), radiance)
    return radiance


def _room(point: Tensor, axis: Tensor, sign: Tensor) -> Tensor:
    x, y, z = point.unbind(-1)
    up = ((y - _WALLS[2]) / (_WALLS[3] - _WALLS[2]))[..., None]
    left = ((_WALLS[1] - x) / (_WALLS[1] - _WALLS[0]))[..., None]
    plaster = torch.lerp(point.new_tensor([0.16, 0.12, 0.09]), point.new_tensor([0.34, 0.37, 0.42]), up)
    plaster = plaster * (0.45 + 0.9 * left**2)  # brighter near the window on the left
    tile = ((torch.floor(x / 0.8) + torch.floor(z / 0.8)) % 2 == 0)[..., None]
    floor = torch.where(tile, point.new_tensor([0.16, 0.14, 0.12]), point.new_tensor([0.006, 0.007, 0.009]))
    floor = floor * (0.3 + 1.4 * left)
    ceiling = point.new_tensor([0.11, 0.115, 0.12]) * (0.4 + left)
    flat = torch.where((sign < 0)[..., None], floor, ceiling)
    return torch.where((axis == 1)[..., None], flat, plaster)


def _add_panel(radiance: Tensor, panel: _Panel, point: Tensor, on_wall: Tensor) -> Tensor:
    inside = on_wall
    clear = torch.ones_like(on_wall)
    others = [k for k in range(3) if k != panel.axis]
    for k, centre, half, bars in zip(others, panel.centre, panel.half, panel.bars, strict=True):
        along = (point[..., k] - centre) / half
        inside = inside & (along.abs() <= 1)
        if bars > 1:
            clear = clear & (((along + 1) * (bars / 2)) % 1 - 0.5).abs().lt(0.44)
    radiance = torch.where(inside[..., None], point.new_tensor([0.03, 0.025, 0.02]), radiance)
    return torch.where((inside & clear)[..., None], point.new_tensor(panel.radiance), radiance)
