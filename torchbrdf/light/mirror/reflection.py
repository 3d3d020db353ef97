"""`Reflection`: where a camera sees the light of each direction in a mirror ball (Alhazen's problem, from far away)."""

from dataclasses import dataclass
from functools import cached_property
from math import asin, ceil, cos, pi, radians, sin

import torch
from torch import Tensor

from torchbrdf.camera import Ball

_STEPS = 6
_NODES = 1 << 14
"""Of the table of normals by reflected angle: linear between them is exact to 1e-8."""

_DENSITY = pi / 2
"""Rows of a lat-long map as fine as the middle of a ball, over its radius in pixels."""


@dataclass(frozen=True)
class Reflection:
    """What a mirror ball shows of the light, in a photograph by the ball's own camera.

    The ball's radius is 1 and its distance D = 1 / sin(radius). At the normal's angle g from the line towards the
    camera, that is seen at delta = atan(sin g / (D - cos g)) on its other side, and light comes from psi = 2 g + delta.
    """

    ball: Ball

    @property
    def rows(self) -> int:
        """Of a lat-long map about as fine."""
        return ceil(_DENSITY * self.ball.circle[2])

    @property
    def distance(self) -> float:
        """D, of the ball's middle from the camera, in radii."""
        return 1 / sin(radians(self.ball.radius_deg))

    @property
    def widest(self) -> float:
        """The largest psi that is reflected, at the rim; the cone beyond lies behind the ball."""
        return pi - radians(self.ball.radius_deg)

    def normals(self, directions: Tensor) -> tuple[Tensor, Tensor]:
        """The angle g (...) of the normals that reflect unit directions (..., 3), and the normals (..., 3).

        NaN in the cone behind the ball.
        """
        axis = -directions.new_tensor(self.ball.direction)
        along = directions @ axis
        across = directions - along[..., None] * axis
        sine = torch.linalg.norm(across, dim=-1)
        place = torch.atan2(sine, along) * (_NODES / self.widest)
        node = place.floor().clamp(0, _NODES - 1)
        table = self._by_angle.to(directions)
        first = table[node.long()]
        g = first + (place - node) * (table[node.long() + 1] - first)
        g = torch.where(place <= _NODES, g, torch.nan)
        return g, torch.cos(g)[..., None] * axis + across * (torch.sin(g) / sine.clamp_min(1e-12))[..., None]

    def places(self, normals: Tensor) -> Tensor:
        """(..., 2): where in the photograph the camera sees the points of normals (..., 3); NaN for NaN."""
        return self.ball.camera.project(normals + self.distance * normals.new_tensor(self.ball.direction))

    def incidence(self, g: Tensor) -> Tensor:
        """(...): the angle between a normal at g and the direction that it reflects, in radians."""
        return g + self._tilt(g)

    def sharpness(self, g: Tensor) -> Tensor:
        """(...): how finely pixels show light along the ball's radius, where they do least: 1 in the middle to 0."""
        return torch.nan_to_num(torch.cos(self.incidence(g)).clamp_min(0))

    def normals_at(self, places: Tensor) -> Tensor:
        """(..., 3): unit normals of the ball at places (..., 2) of the photograph; NaN beside it."""
        return self._hit(self.ball.camera.rays(places))

    def light(self, places: Tensor) -> Tensor:
        """(..., 3): unit directions from which the light at places (..., 2) of the photograph comes; NaN beside it."""
        rays = self.ball.camera.rays(places)
        normals = self._hit(rays)
        return rays - 2 * (rays * normals).sum(-1, keepdim=True) * normals

    def _hit(self, rays: Tensor) -> Tensor:
        middle = self.distance * rays.new_tensor(self.ball.direction)
        along = rays @ middle
        beside = along**2 - (self.distance**2 - 1)
        reach = along - torch.where(beside >= 0, beside, torch.nan).sqrt()
        return reach[..., None] * rays - middle

    def solid_angles(self, usable: Tensor) -> Tensor:
        """(H, W) float64, in sr: of the light in each pixel of the photograph; 0 where (H, W) `usable` is False."""
        rows, columns = (axis.to(torch.float64) + 0.5 for axis in usable.nonzero(as_tuple=True))
        middle = torch.stack([columns, rows], -1)
        step = middle.new_tensor([[0.25, 0.0], [0.0, 0.25]])
        across, down = (self.light(middle + each) - self.light(middle - each) for each in step)
        angles = torch.zeros(usable.shape, dtype=torch.float64)
        angles[usable] = torch.nan_to_num(torch.linalg.norm(torch.linalg.cross(across, down), dim=-1) * 4)
        return angles

    @cached_property
    def _by_angle(self) -> Tensor:
        """(N + 1,) float64: g at psi from 0 to the widest, by Newton's method."""
        psi = torch.linspace(0, self.widest, _NODES + 1, dtype=torch.float64)
        g = psi * (asin(cos(radians(self.ball.radius_deg))) / self.widest)
        for _ in range(_STEPS):
            slope = 2 + (self.distance * g.cos() - 1) / (self.distance**2 + 1 - 2 * self.distance * g.cos())
            g = g - (2 * g + self._tilt(g) - psi) / slope
        return g

    def _tilt(self, g: Tensor) -> Tensor:
        return torch.atan2(torch.sin(g), self.distance - torch.cos(g))
