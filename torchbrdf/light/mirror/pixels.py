"""Which pixels of a photograph a ball covers."""

import torch
from torch import Tensor

from torchbrdf.camera import Ball


def inside(ball: Ball, margin: float = 0.0) -> Tensor:
    """(H, W) bool: pixels of the photograph that lie wholly inside the silhouette, by `margin` pixels more."""
    corners = _corners(ball, -margin)
    return corners[1:, 1:] & corners[1:, :-1] & corners[:-1, 1:] & corners[:-1, :-1]


def touched(ball: Ball, margin: float = 0.0) -> Tensor:
    """(H, W) bool: pixels of which a corner lies in the silhouette, or within `margin` pixels of it."""
    corners = _corners(ball, margin)
    return corners[1:, 1:] | corners[1:, :-1] | corners[:-1, 1:] | corners[:-1, :-1]


def _corners(ball: Ball, margin: float) -> Tensor:
    y, x = (torch.arange(n + 1, dtype=torch.float64) for n in ball.camera.size)
    places = torch.stack(torch.broadcast_tensors(x, y[:, None]), -1)
    return Ball(ball.camera, ball.direction, ball.radius_deg * (1 + margin / ball.circle[2])).contains(places)
