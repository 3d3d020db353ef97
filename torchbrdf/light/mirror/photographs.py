"""From one or two photographs of a mirror ball to a light probe in the frame of the first camera."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import torch
from torch import Tensor

from torchbrdf.camera import Ball
from torchbrdf.light.lamps import bounded, lamps_of
from torchbrdf.light.latlong import LEAST_HEIGHT, row_solid_angles
from torchbrdf.light.mirror.filling import filled
from torchbrdf.light.mirror.metals import Metal
from torchbrdf.light.mirror.pixels import inside
from torchbrdf.light.mirror.reflection import Reflection
from torchbrdf.light.mirror.registration import Registration, find_rotation
from torchbrdf.light.mirror.unwrapping import Reflectance, Seen, reflected, surroundings

_ROUNDING = 1e-6
_ABOVE = 1.5
"""Times as bright as the others on the mean."""


@dataclass(frozen=True)
class MirrorPhotograph:
    """A photograph and the mirror ball in it.

    image   (3, H, W) linear radiance; pixels of NaN are not used, infinite ones are lamps of unknown radiance
    ball    where its camera sees it
    usable  (H, W) bool: pixels of the ball that may be used; None for all
    Raises ValueError for another size than the camera's, or without a pixel of the ball that holds radiance.
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
        if not bool((self.shown & torch.isfinite(self.image).all(0)).any()):
            raise ValueError("no pixel of the ball can be used: the mask leaves none, or all are NaN or infinite")

    @cached_property
    def shown(self) -> Tensor:
        """(H, W) bool: pixels wholly inside the ball that may be used."""
        covered = inside(self.ball)
        return covered if self.usable is None else covered & self.usable

    @cached_property
    def sound(self) -> Tensor:
        """(H, W) bool: pixels that hold radiance, be it infinite."""
        return (torch.isfinite(self.image) | self.infinite).all(0)

    @cached_property
    def infinite(self) -> Tensor:
        """(3, H, W) bool."""
        return self.image == torch.inf

    @cached_property
    def bounded(self) -> Tensor:
        """(3, H, W): the image with infinite values as bright as the brightest finite one."""
        return bounded(self.image, self.sound)[0]

    @property
    def lost(self) -> int:
        """How many of the pixels shown are too bright: infinite."""
        return int((self.shown & self.infinite.any(0)).sum())

    def with_lamps_lost(self) -> MirrorPhotograph:
        """The same, infinite where its brightest pixels are certain to be clipped at one value; see `Lamps.certain`."""
        weights = Reflection(self.ball).solid_angles(self.shown & self.sound)
        lamps = lamps_of(torch.where(weights > 0, self.bounded, 0.0), weights)
        if lamps is None or not lamps.certain or self.lost:
            return self
        return replace(self, image=torch.where(lamps.radiance > 0, torch.inf, self.image))

    @cached_property
    def white(self) -> float:
        """Share of the pixels shown that hold the largest value of all, much above the others; 0 where they do not."""
        shown = self.bounded[:, self.shown & self.sound]
        at_most = (shown >= (1 - _ROUNDING) * shown.max()).any(0)
        others = shown[:, ~at_most]
        return float(at_most.double().mean()) if others.numel() and shown.max() > _ABOVE * others.mean() else 0.0

    @property
    def empty(self) -> int:
        """How many of the pixels shown hold none."""
        return int((self.shown & ~self.sound).sum())


@dataclass(frozen=True)
class MirrorProbe:
    """A light probe, and what of it was seen.

    radiance   (3, H, 2 H), in the frame of the first camera: it looks along -Z, image right is +X; infinite where the
               photographs are
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
        """Share of the light, as filled in, of all three channels; without what is infinite."""
        power = self.radiance.double().nan_to_num(posinf=0.0).sum(0) * row_solid_angles(*directions.shape)[:, None]
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
    sides = [_Side(one, seen, rows) for one, seen in zip(photographs, reflections, strict=True)]
    turn = None
    if len(sides) == 2:
        turn = find_rotation(*(side.mirrored(side.photograph.bounded, share) for side in sides))
        sides[1] = replace(sides[1], rotation=turn.rotation)

    def joined(images: Iterable[Tensor], share: Reflectance | None = None) -> tuple[Seen, Seen]:
        """What is seen of images of their size, in the balls, and beside them, too, where balls show nothing."""
        pairs = list(zip(sides, images, strict=True))
        seen = reduce(Seen.averaged, (side.mirrored(image, share) for side, image in pairs))
        return seen, reduce(Seen.completed, (side.surroundings(image) for side, image in pairs if beside), seen)

    gains = (1.0,) if turn is None else (1.0, turn.gain)
    seen, whole = joined((one.bounded / gain for one, gain in zip(photographs, gains, strict=True)), share)
    radiance = filled(whole)
    if any(bool(one.infinite.any()) for one in photographs):
        _, infinite = joined(one.infinite.to(one.image.dtype) for one in photographs)
        radiance = torch.where(_mostly(infinite.radiance), torch.inf, radiance)
    return MirrorProbe(radiance, seen.known, whole.known & ~seen.known, turn)


@dataclass(frozen=True)
class _Side:
    """One of the photographs, and how it sees the light.

    rows      of the lat-long map
    rotation  (3, 3), from its camera's frame to the map's; None where they are the same
    """

    photograph: MirrorPhotograph
    reflection: Reflection
    rows: int
    rotation: Tensor | None = None

    def mirrored(self, image: Tensor, share: Reflectance | None) -> Seen:
        """What an image (3, H, W) of its size shows in the ball."""
        usable = self.photograph.shown & self.photograph.sound
        return reflected(image, usable, self.reflection, self.rows, share, self.rotation)

    def surroundings(self, image: Tensor) -> Seen:
        """What it shows beside the ball."""
        return surroundings(image, self.photograph.sound, self.photograph.ball, self.rows, self.rotation)


def _mostly(shares: Tensor) -> Tensor:
    """(3, H, 2 H) bool: texels of which flagged pixels have the larger share, or, of a patch too small, the largest."""
    around = torch.nn.functional.max_pool2d(
        torch.cat([shares[..., -1:], shares, shares[..., :1]], -1), 3, stride=1, padding=(1, 0)
    )
    return (shares > 0) & (shares >= around / 2)


def _constant(given: float | Sequence[float]) -> Reflectance:
    factors = torch.tensor([given] if isinstance(given, (int, float)) else list(given)).expand(3)
    return lambda angles: factors.to(angles).expand(*angles.shape, 3)
