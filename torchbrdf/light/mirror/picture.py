"""`MirrorPicture`: a mirror ball in perspective, beside the layouts of pictures that are seen from infinity."""

from dataclasses import dataclass
from functools import cached_property
from math import pi

import torch
from torch import Tensor

from torchbrdf.light.mirror.filling import filled
from torchbrdf.light.mirror.pixels import inside
from torchbrdf.light.mirror.reflection import Reflection
from torchbrdf.light.mirror.unwrapping import reflected


@dataclass(frozen=True)
class MirrorPicture:
    """A picture by the camera of a mirror ball, as a placed layout is."""

    reflection: Reflection

    @property
    def rows(self) -> int:
        """Of a lat-long map about as fine."""
        return self.reflection.rows

    @cached_property
    def description(self) -> str:
        """In words, for people."""
        ball = self.reflection.ball
        unseen = 1 - float(self.weights().sum()) / (4 * pi)
        return f"{ball}, {ball.beside}, {unseen:.1%} of the sphere, behind it, filled from around"

    def weights(self, margin: float = 0.0) -> Tensor:
        """(H, W) float64: the pixels' solid angles in sr; 0 where not wholly inside, by `margin` pixels more."""
        return self.reflection.solid_angles(inside(self.reflection.ball, margin))

    def to_latlong(self, image: Tensor, height: int) -> Tensor:
        """(3 n, height, 2 height): the light that the picture (3 n, H, W) shows; the rest from around it."""
        usable = inside(self.reflection.ball).to(image.device)
        return torch.cat([filled(reflected(part, usable, self.reflection, height)) for part in image.split(3)])
