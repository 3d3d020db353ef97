"""A photographer's studio: a light of the gallery's own, computed from direction functions, no file.

Grey all round, so that colours are the materials'. A softbox with panes and a bulb tell gloss by how sharply they are
mirrored; two strips behind the ball are seen only at grazing angles.
"""

from dataclasses import dataclass
from functools import cache
from math import cos, radians

import torch
from torch import Tensor
from torch.nn.functional import normalize

import torchbrdf as tb
from torchbrdf.light import area_mean

_SUPERSAMPLING = 6
_MULLION = 0.05
"""Radiance of what separates panes."""


@dataclass(frozen=True)
class _Box:
    """A rectangle that faces the ball: where, tangents of half its angles across and up, radiance, panes a side."""

    towards: tuple[float, float, float]
    half: tuple[float, float]
    radiance: tuple[float, float, float]
    panes: int = 1


_BOXES = (
    _Box((-0.78, 0.66, 0.62), (0.50, 0.50), (17.0, 16.6, 16.0), panes=2),  # key, before the ball at the left
    _Box((0.92, 0.12, -0.22), (0.13, 0.75), (7.0, 7.3, 7.8)),  # strip behind the ball at the right
    _Box((-0.80, 0.00, -0.62), (0.10, 0.55), (6.0, 6.1, 6.3)),  # and at the left
)
_BULB, _BULB_DEG, _BULB_RADIANCE = (0.62, 0.42, 0.76), 2.0, (600.0, 570.0, 530.0)


@cache
def studio(height: int = 256) -> tb.LightProbe:
    """The light, with so many rows; made once."""
    return tb.LightProbe(area_mean(_radiance, height, 2 * height, _SUPERSAMPLING), name="gallery studio")


def _radiance(directions: Tensor) -> Tensor:
    """Radiance (..., 3) from unit directions (..., 3)."""
    up = directions[..., 1:2]
    grey = torch.where(up > 0, 0.42 + 0.50 * up, 0.34 * torch.exp(5 * up.clamp_max(0)) + 0.08)
    radiance = grey.expand_as(directions)
    for box in _BOXES:
        radiance = _with_box(radiance, box, directions)
    bulb = directions @ normalize(torch.tensor(_BULB), dim=0) > cos(radians(_BULB_DEG))
    return torch.where(bulb[..., None], torch.tensor(_BULB_RADIANCE), radiance)


def _with_box(radiance: Tensor, box: _Box, directions: Tensor) -> Tensor:
    z = normalize(torch.tensor(box.towards), dim=0)
    x = normalize(torch.linalg.cross(torch.tensor([0.0, 1.0, 0.0]), z), dim=0)
    depth = directions @ z
    axes = (x, torch.linalg.cross(z, x))
    places = [directions @ axis / depth / half for axis, half in zip(axes, box.half, strict=True)]
    inside = (depth > 0) & torch.stack([place.abs() <= 1 for place in places]).all(0)
    clear = inside
    if box.panes > 1:
        for place in places:
            clear = clear & ((((place + 1) * (box.panes / 2)) % 1 - 0.5).abs() < 0.46)
    radiance = torch.where(inside[..., None], torch.tensor(_MULLION), radiance)
    return torch.where(clear[..., None], torch.tensor(box.radiance), radiance)
