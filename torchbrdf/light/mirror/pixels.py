"""Which pixels of a photograph a ball covers."""

from torch import Tensor

from torchbrdf.camera import Ball, touched as touched_by, wholly_inside


def inside(ball: Ball, margin: float = 0.0) -> Tensor:
    """(H, W) bool: pixels of the photograph that lie wholly inside the silhouette, by `margin` pixels more."""
    return wholly_inside(grown(ball, -margin).contains, *_whole(ball))


def touched(ball: Ball, margin: float = 0.0) -> Tensor:
    """(H, W) bool: pixels of which a corner lies in the silhouette, or within `margin` pixels of it."""
    return touched_by(grown(ball, margin).contains, *_whole(ball))


def grown(ball: Ball, margin: float) -> Ball:
    """With a silhouette larger by so many pixels."""
    return Ball(ball.camera, ball.direction, ball.radius_deg * (1 + margin / ball.circle[2]))


def _whole(ball: Ball) -> tuple[slice, slice]:
    height, width = ball.camera.size
    return slice(0, height), slice(0, width)
