"""Which of the balls in a photograph is meant, or what to do where that is not clear."""

from __future__ import annotations

import warnings
from math import hypot

import torch
from torch import Tensor

from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.images import Window
from torchbrdf.photograph._filling import apart, cut_out, fills
from torchbrdf.photograph._pyramid import Pyramid
from torchbrdf.photograph.finding import FITTED_RADIUS, FoundBall, any_sure, balls_of, find_balls, find_near
from torchbrdf.photograph.silhouette import SNAP, Circle

_LIKE_SIZE = 0.9
"""From this ratio of radii on the larger is not meant by its size."""

_MOST_OUTSIDE = 1 / 3
_CLEAR_RIM, _CLEAR_SCORE = 0.55, 1.0
_WEAK, _STRONGER, _MOST_SEEN = 2.0, 1.3, 0.65
"""Score below which an outline before a camera is compared with circles; ratio of scores, and share of the rim, from
which a circle is none by this camera. On the design captures circles score 0.6 to 1.2 times as much as what is right,
and 1.3 to 4 times as much as what is found for a camera of 60 or 90 degrees that has 24."""
_FOVS = torch.linspace(4, 140, 273).tolist()
_WELL = 0.5
"""Of the deviation from a ball that may be left where another field of view explains it."""

_ANOTHER = 0.05
"""Radii by which a ball that is seen is another than the one that is given."""

_INSTEAD = "give its place, --circle X Y R in pixels, or a --mask"


def locate(
    image: Tensor,
    camera: PinholeCamera | None = None,
    usable: Tensor | None = None,
    window: Window | None = None,
    number: int | None = None,
) -> tuple[Circle | Ball, str]:
    """The ball in a photograph that has no mask, and how it was found, for people.

    image   (3, H, W)  linear radiance
    camera  of the whole photograph; None where it is not known: the ball is a circle
    usable  (1, H, W)  bool, True = use; None uses all that is finite
    window  the part of the photograph that was recorded; None for all
    number  of the ball, counted from 1, the largest; None for the largest
    A square photograph (or window) in which no other ball is seen is a crop to the ball, which fills it, unless one
    value is all around a smaller one; one cut out along its inscribed circle is the ball, whatever is seen in it.
    Warns where another ball than that may be meant, and where such a crop shows neither its rim nor empty corners.
    Raises ValueError where there is no ball, or none for certain; for two of like size without a number; for one of
    which more than a third is cut off, and for an outline that no sphere has before the camera.
    """
    height, width = image.shape[-2:]
    parts = {"the photograph": Window(0, 0, width, height)} | ({"what was recorded": window} if window else {})
    square = {what: part for what, part in parts.items() if abs(part.width - part.height) < SNAP}
    what, part = square.popitem() if number is None and square else ("", None)
    crop = None if part is None else Circle.inscribed(part)
    smaller = None if crop is None else apart(image, usable, crop)
    if crop is not None and smaller is None and camera is None and cut_out(image, usable, crop):
        return crop, f"as large as {what}, which is cut to it"
    pyramid = Pyramid.of(image, usable)
    none = crop is not None and camera is None and not any_sure(pyramid)
    found = [] if none else balls_of(pyramid, camera)
    balls = [ball for ball in found if ball.sure]
    if crop is not None:
        others = [ball for ball in balls if ball.circle.differs(crop) >= SNAP]
        if not any(_beyond_doubt(ball) for ball in others):
            if smaller is None:
                _doubt(others, fills(image, usable, crop))
            shown = smaller or crop
            told = f"as large as {what}" if smaller is None else f"before one value, which is all else in {what}"
            return shown if camera is None else Ball.of_circle(camera, *shown.circle), told
    if camera is not None:
        _check_camera(max((ball.score for ball in found), default=0.0), pyramid, camera)
    if not balls:
        unknown = (
            "" if camera is not None else "; off the middle it is an ellipse, for which the camera is needed: --fov"
        )
        seen = f"no ball is found for certain; there may be one, {found[0]}" if found else "no ball is found"
        raise ValueError(f"{seen}{unknown}. To use one, {_INSTEAD}")
    ball = the_ball(balls, number)
    _check(ball, camera, (height, width))
    place = balls.index(ball) + 1
    deviation = max(ball.std)
    return (
        ball.silhouette,
        f"ball {place} of {len(balls)} found, to {deviation:.2g} pixels, {ball.rim:.0%} of its rim seen",
    )


def another(image: Tensor, silhouette: Circle | Ball) -> FoundBall | None:
    """The ball that is seen beyond doubt where a silhouette is said to be, but not as it is said; None for none."""
    x, y, radius = silhouette.circle
    camera = silhouette.camera if isinstance(silhouette, Ball) else None

    def as_said(ball: FoundBall) -> bool:
        return ball.circle.differs(Circle(x, y, radius)) <= _ANOTHER * radius

    near = find_near(image, silhouette)  # in a tenth of a second, not in one
    if near is not None and _beyond_doubt(near) and as_said(near):
        return None
    for ball in find_balls(image, camera):
        over = hypot(ball.circle.x - x, ball.circle.y - y) < max(radius, ball.circle.radius)
        if over and ball.sure and ball.round and _beyond_doubt(ball):
            return None if as_said(ball) else ball
    return None


def the_ball(balls: list[FoundBall], number: int | None) -> FoundBall:
    """The largest of balls, the largest first, or the one with a number."""
    listed = "; ".join(f"{i}: {ball}" for i, ball in enumerate(balls, 1))
    if number is not None:
        if number > len(balls):
            raise ValueError(f"--ball {number} is not among the balls found, {listed}")
        return balls[number - 1]
    if len(balls) > 1 and balls[1].circle.radius > _LIKE_SIZE * balls[0].circle.radius:
        raise ValueError(f"several balls of like size are found, {listed}; say which: --ball N")
    return balls[0]


def _beyond_doubt(ball: FoundBall) -> bool:
    """Whether a circle is hardly a reflection in a ball that fills a crop."""
    return ball.rim >= _CLEAR_RIM * (1 - ball.outside) and ball.score >= _CLEAR_SCORE


def _doubt(others: list[FoundBall], seen: bool) -> None:
    """Warn where a ball that fills a crop is not seen, or another is."""
    if others:
        message = f"the ball is taken to fill the photograph; if it is {others[0]}, then {_INSTEAD}"
        warnings.warn(message, UserWarning, stacklevel=3)
    elif not seen:
        message = (
            "the ball is taken to fill the photograph, as no other is found, but neither is a rim seen there nor are "
            f"the corners cut away; if it does not fill it, {_INSTEAD}"
        )
        warnings.warn(message, UserWarning, stacklevel=3)


def _check(ball: FoundBall, camera: PinholeCamera | None, size: tuple[int, int]) -> None:
    """Raise where a found outline cannot be used."""
    if ball.outside > _MOST_OUTSIDE:
        raise ValueError(
            f"the photograph's border cuts off {ball.outside:.0%} of the ball, {ball}; "
            "at most a third may be missing: photograph all of it"
        )
    if not ball.round:
        off = ball.flattened[0] / ball.circle.radius * FITTED_RADIUS
        fov = fitting_fov(ball.edge, camera or PinholeCamera.of_fov(size, _FOVS[0]))
        before = (
            "no camera is known, for which it would be a sphere's" if camera is None else f"no sphere's in a {camera}"
        )
        would = "give --fov" if fov is None else f"--fov {fov:.0f} would make it one"
        raise ValueError(
            f"the outline of the ball, {ball}, is an ellipse, {off:.1f} pixels of {2 * FITTED_RADIUS} off, and "
            f"{before}: {would}; or {_INSTEAD}"
        )


def _check_camera(score: float, pyramid: Pyramid, camera: PinholeCamera) -> None:
    """Raise where a circle is seen much better than what a ball is before the camera."""
    if score >= _WEAK:
        return
    circles = [
        ball
        for ball in balls_of(pyramid, None)
        if ball.sure and ball.score > _STRONGER * score and ball.rim >= _MOST_SEEN * (1 - ball.outside)
    ]
    if circles:
        fov = fitting_fov(circles[0].edge, camera)
        better = "" if fov is None else f" (about --fov {fov:.0f} would suit it)"
        given = "are --fov, --principal and --distortion" if any(camera.distortion) else "is --fov"
        raise ValueError(
            f"the outline that is seen best, {circles[0]}, is no sphere's in a {camera}: {given} right{better}? "
            f"Else {_INSTEAD}"
        )


def fitting_fov(edge: Tensor, camera: PinholeCamera) -> float | None:
    """The field of view with which an outline (n, 2) would be a sphere's; None where none is much better than others.

    Directions d of a cone fulfil d . u = 1 for its middle over the cosine of its radius, which is linear in u.
    """
    if any(camera.distortion):
        return None

    def deviation(fov_deg: float) -> float:
        trial = PinholeCamera.of_fov(camera.size, fov_deg, camera.principal)
        rays = trial.rays(edge.double())
        cone = torch.linalg.lstsq(rays, torch.ones(len(edge), 1, dtype=torch.float64)).solution
        return float((rays @ cone - 1).norm() / (cone.square().sum() - 1).clamp_min(1e-12).sqrt()) * trial.focal

    best = min(_FOVS, key=deviation)
    return best if deviation(best) < _WELL * deviation(camera.fov_deg) else None
