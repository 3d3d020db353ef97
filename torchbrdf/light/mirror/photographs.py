"""From one or two photographs of a mirror ball to a light probe in the frame of the first camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from torchbrdf.camera import Ball
from torchbrdf.light.latlong import LEAST_HEIGHT, row_solid_angles
from torchbrdf.light.mirror.filling import filled
from torchbrdf.light.mirror.metals import Metal
from torchbrdf.light.mirror.pixels import inside
from torchbrdf.light.mirror.reflection import Reflection
from torchbrdf.light.mirror.registration import Registration, find_rotation
from torchbrdf.light.mirror.unwrapping import Reflectance, reflected, surroundings


@dataclass(frozen=True)
class MirrorPhotograph:
    """A photograph and the mirror ball in it.

    image   (3, H, W) linear radiance; pixels of NaN are not used
    ball    where its camera sees it
    usable  (H, W) bool: pixels of the ball that may be used; None for all
    Raises ValueError for another size than the camera's, or infinite pixels in the ball.
    """

    image: Tensor
    ball: Ball
    usable: Tensor | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        size = self.image.shape[-2:]
        if self.image.ndim != 3 or len(self.image) != 3 or tuple(size) != tuple(self.ball.camera.size):
            wanted = " x ".join(str(n) for n in self.ball.camera.size)
            raise ValueError(f"a photograph by this camera is (3, {wanted}), got {tuple(self.image.shape)}")
        clipped = self.shown & (self.image == torch.inf).any(0)
        if bool(clipped.any()):
            raise ValueError(
                f"{int(clipped.sum())} pixels of the ball are infinite: a lamp brighter than the numbers that it was "
                "saved in; save it with 32-bit floats, or leave them out with --mask FILE"
            )
        if not bool((self.shown & self.sound).any()):
            raise ValueError("no pixel of the ball can be used: the mask leaves none, or all hold NaN")

    @cached_property
    def shown(self) -> Tensor:
        """(H, W) bool: pixels wholly inside the ball that may be used."""
        covered = inside(self.ball)
        return covered if self.usable is None else covered & self.usable

    @cached_property
    def sound(self) -> Tensor:
        """(H, W) bool: pixels that hold radiance."""
        return torch.isfinite(self.image).all(0)

    @property
    def empty(self) -> int:
        """How many of the pixels shown hold none."""
        return int((self.shown & ~self.sound).sum())


@dataclass(frozen=True)
class MirrorProbe:
    """A light probe, and what of it was seen.

    radiance   (3, H, 2 H), in the frame of the first camera: it looks along -Z, image right is +X
    reflected  (H, 2 H) bool: directions seen in a ball
    beside     (H, 2 H) bool: others, seen beside one
    turn       of the second photograph's camera; None for one photograph
    """

    radiance: Tensor
    reflected: Tensor
    beside: Tensor
    turn: Registration | None = None

    @property
    def filled(self) -> Tensor:
        """(H, 2 H) bool: directions that no photograph shows, continued from around them."""
        return ~(self.reflected | self.beside)

    def share(self, directions: Tensor) -> float:
        """Of the sphere, from 0 to 1, for (H, 2 H) bool."""
        weights = row_solid_angles(*directions.shape)[:, None].expand(directions.shape)
        return float(weights[directions].sum() / weights.sum())

    def light(self, directions: Tensor) -> float:
        """Share of the light, as filled in, of all three channels."""
        power = self.radiance.double().sum(0) * row_solid_angles(*directions.shape)[:, None]
        return float(power[directions].sum() / power.sum())


def unwrapped(
    photographs: Sequence[MirrorPhotograph],
    reflectance: float | Sequence[float] | Metal = 1.0,
    height: int | None = None,
    beside: bool = True,
) -> MirrorProbe:
    """The light of one photograph of a mirror ball, or of two from different sides, as a lat-long map.

    reflectance  the share that the ball reflects: one number, three, or a metal
    height       rows; default: as fine as the middle of the ball, and at least 512
    beside       also use what the photographs show beside the ball, where the ball shows nothing
    The light is taken to be far away. Where two photographs see a direction, the sharper counts more. What none sees
    (the cone behind the ball, and around it what lies in pixels that the silhouette cuts) is continued from around it.
    Raises ValueError for more than two photographs, or two that do not show the same light.
    """
    if not 1 <= len(photographs) <= 2:
        raise ValueError(f"a mirror probe is made of one or two photographs, got {len(photographs)}")
    share = reflectance.reflectance if isinstance(reflectance, Metal) else _constant(reflectance)
    reflections = [Reflection(each.ball) for each in photographs]
    rows = height or max(LEAST_HEIGHT, *(each.rows for each in reflections))
    parts = list(zip(photographs, reflections, strict=True))
    views = [reflected(one.image, one.shown & one.sound, seen, rows, share) for one, seen in parts]
    turn = None
    seen = views[0]
    if len(views) == 2:
        turn = find_rotation(*views)
        one, other = parts[1]
        again = reflected(one.image / turn.gain, one.shown & one.sound, other, rows, share, turn.rotation)
        seen = seen.averaged(again)
    whole = seen
    for index, one in enumerate(photographs if beside else ()):
        gain, rotation = (turn.gain, turn.rotation) if turn is not None and index else (1.0, None)
        whole = whole.completed(surroundings(one.image / gain, one.sound, one.ball, rows, rotation))
    return MirrorProbe(filled(whole), seen.known, whole.known & ~seen.known, turn)


def _constant(given: float | Sequence[float]) -> Reflectance:
    factors = torch.tensor([given] if isinstance(given, (int, float)) else list(given)).expand(3)
    return lambda angles: factors.to(angles).expand(*angles.shape, 3)
