"""What a photograph shows of its shape: read, found in its frame, resampled; `fit` and `live` share it."""

import argparse
import warnings
from dataclasses import dataclass

from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.commands._inputs import about, open_camera, open_view
from torchbrdf.photograph import (
    LARGEST_DEFAULT_SIZE,
    Circle,
    Observation,
    Photograph,
    another,
    find_ball,
    find_circle,
    locate,
    observe,
    observe_view,
)
from torchbrdf.report import Scene, few_pixels
from torchbrdf.view import View

_CLIPPED = 0.002
"""Of the shape's pixels: with more at the largest whole number the command warns."""


@dataclass(frozen=True)
class Sight:
    """What is seen of the shape, and how it was found there.

    photograph  whole, as it was read
    silhouette  of a ball in it; None for other shapes
    found       how it was found, for people
    about       for people: how the file was read, the silhouette, the pixels used
    """

    observation: Observation
    view: View
    photograph: Photograph
    silhouette: Circle | Ball | None
    found: str
    about: str

    @property
    def scene(self) -> Scene | None:
        """For the report."""
        if self.silhouette is None:
            return None
        return Scene(self.photograph.image, self.silhouette.outline(), self.found)


def read_observation(options: argparse.Namespace, size: int | None) -> Sight:
    """The photograph, its mask and circle, resampled to `size`, and the shape that it shows."""
    photograph = Photograph.open(
        options.photo,
        options.mask,
        invert_mask=options.invert_mask,
        allow_ldr=options.allow_ldr,
        layer=options.layer,
        primaries=options.primaries,
        encoding=options.encoding,
    )
    if options.view == "sphere":
        observation, view, silhouette, found = _ball(options, photograph, size)
    else:
        for name in ("circle", "ball"):
            if getattr(options, name) is not None:
                raise ValueError(f"--{name} is for a ball, and --view is {options.view}")
        view = open_view(options, size or min(LARGEST_DEFAULT_SIZE, photograph.image.shape[-1]))
        with about(options.photo):
            observation = observe_view(photograph.image, view, photograph.usable)
        silhouette, found = None, f"shape of {options.view}"
    used, seen = int(observation.mask.sum()), len(view.pixels)
    if few := few_pixels(used, seen):
        warnings.warn(f"{options.photo}: {few}", UserWarning, stacklevel=2)
    if (clipped := photograph.clipped_share(silhouette)) > _CLIPPED:
        message = (
            f"{options.photo}: {clipped:.1%} of the shape's pixels have the largest number that the file can hold, and "
            "look clipped: the highlight is lost there, and its BRDF too dim and broad; merge shorter exposures, or "
            "mask those pixels"
        )
        warnings.warn(message, UserWarning, stacklevel=2)
    height, width = view.size
    read = f" ({'; '.join(photograph.about)})" if photograph.about else ""
    return Sight(
        observation,
        view,
        photograph,
        silhouette,
        found,
        f"{options.photo}{read}: {found}; {used} of its {seen} pixels used, at {height} x {width}",
    )


def _ball(
    options: argparse.Namespace, photograph: Photograph, size: int | None
) -> tuple[Observation, View, Circle | Ball, str]:
    """What a photograph shows of a ball, the view of it, its silhouette, and in words how that was found."""
    with about(options.photo):
        camera, told = open_camera(options, options.photo, photograph.size)
        silhouette, origin = find_silhouette(options, photograph, camera)
        observation = observe(photograph.image, silhouette, photograph.usable, size)
        ball = silhouette if isinstance(silhouette, Ball) else None
        view = open_view(options, observation.image.shape[-1], ball)
    seen = "" if ball is None else f", {ball.beside}, {told}"
    return observation, view, silhouette, f"{silhouette}, {origin}{seen}"


def find_silhouette(
    options: argparse.Namespace, photograph: Photograph, camera: PinholeCamera | None
) -> tuple[Circle | Ball, str]:
    """Where the ball is, by `options.circle`, `.mask`, `.ball` and `.photo`, and how that was found.

    Warns where a ball is seen there that is not as a circle or mask gives it.
    """
    silhouette, origin = _located(options, photograph, camera)
    given = "--circle" if options.circle is not None else "the mask" if photograph.mask is not None else None
    if given and (seen := another(photograph.image, silhouette)) is not None:
        message = f"{options.photo}: {seen} is seen, and {silhouette} is given by {given}, which is taken; is it right?"
        warnings.warn(message, UserWarning, stacklevel=2)
    return silhouette, origin


def _located(
    options: argparse.Namespace, photograph: Photograph, camera: PinholeCamera | None
) -> tuple[Circle | Ball, str]:
    if options.circle is not None:
        if options.ball is not None:
            raise ValueError(
                f"--ball {options.ball} chooses among the balls found, and --circle gives one: leave one out"
            )
        circle = Circle(*options.circle)
        height, width = photograph.size
        if not circle.holds(height, width).any():
            raise ValueError(f"--circle, {circle}, is outside the photograph, which is {width} wide and {height} high")
        if circle.leaves(*photograph.size):
            message = f"{options.photo}: --circle, {circle}, leaves the photograph on opposite sides"
            warnings.warn(message, UserWarning, stacklevel=2)
        return circle if camera is None else Ball.of_circle(camera, *options.circle), "as given"
    if photograph.mask is None:
        with about(options.photo):
            return locate(photograph.image, camera, photograph.usable, photograph.window, options.ball)
    if options.ball is not None:
        raise ValueError(f"--ball {options.ball} chooses among the balls found without a mask: leave one of them out")
    with about(options.mask or options.photo):
        if camera is None:
            return find_circle(photograph.size, photograph.mask), "of the mask"
        return find_ball(camera, photograph.mask), "of the mask"
