"""Photographs of balls before a striped wall, whose outlines are known exactly."""

from collections.abc import Sequence
from math import radians, sin

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from torchbrdf.camera import Ball
from torchbrdf.photograph import Circle

_PARTS = 4


def photographed(size: tuple[int, int], balls: Sequence[Circle | Ball], seed: int = 0) -> Tensor:
    """(3, H, W): balls that are bright at the top, each pixel the mean of 16 places in it, with 1 % noise."""
    height, _ = size
    down, right = ((torch.arange(n * _PARTS) + 0.5).double() / _PARTS for n in size)
    places = torch.stack(torch.meshgrid(right, down, indexing="xy"), -1)
    wall = 0.5 + 0.2 * torch.sin(places[..., 0] / 9) * torch.sin((places[..., 0] + places[..., 1]) / 17)
    picture = wall[..., None] * torch.tensor([1.0, 0.8, 0.7])
    for ball in balls:
        away = _away(ball, places)
        facing = (1 - away.clamp_max(1) ** 2).sqrt()
        middle = (ball if isinstance(ball, Circle) else Circle(*ball.circle)).y
        shading = 0.1 + facing * (1.2 + (middle - places[..., 1]) / height)
        picture = torch.where((away <= 1)[..., None], shading[..., None] * torch.tensor([0.3, 0.9, 1.6]), picture)
    mean = avg_pool2d(picture.permute(2, 0, 1)[None].float(), _PARTS)[0]
    return mean * (1 + 0.01 * torch.randn(mean.shape, generator=torch.Generator().manual_seed(seed)))


def _away(ball: Circle | Ball, places: Tensor) -> Tensor:
    """From the middle, in radii."""
    if isinstance(ball, Circle):
        return torch.hypot(places[..., 0] - ball.x, places[..., 1] - ball.y) / ball.radius
    cosine = ball.camera.rays(places) @ places.new_tensor(ball.direction)
    return (1 - cosine.clamp_max(1) ** 2).sqrt() / sin(radians(ball.radius_deg))


def off(found: Circle | Ball, true: Circle | Ball) -> float:
    """The larger deviation of centre and radius, in pixels of a ball 64 pixels across."""
    a, b = (one if isinstance(one, Circle) else Circle(*one.circle) for one in (found, true))
    return a.differs(b) / b.radius * 32
