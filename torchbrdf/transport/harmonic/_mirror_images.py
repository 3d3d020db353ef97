"""Pixels that see the same normals as others but for a mirror or a quarter turn about the view axis."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.view import SphereView, View

_IMAGES = 8
"""Of a square: four quarter turns, each of it and of its mirror image."""


@dataclass(frozen=True)
class MirrorImages:
    """The pixels of a view as images of a few of them.

    pixels  (Q,) int64: flat indices of those few
    source  (P,) int64: whose image each pixel of the view is
    image   (P,) int64: which; image 2 q + s of azimuth a is (1 - 2 s) a + q pi / 2
    """

    pixels: Tensor
    source: Tensor
    image: Tensor

    @staticmethod
    def of(view: View) -> "MirrorImages":
        """An eighth of the pixels of a ball in the middle of its picture, all those of other shapes."""
        pixels = view.pixels.cpu()
        if type(view) is not SphereView:
            return MirrorImages(pixels, torch.arange(len(pixels)), torch.zeros_like(pixels))
        n = view.size[1]
        x, y = 2 * (pixels % n) - (n - 1), (n - 1) - 2 * (pixels // n)  # in half pixels from the middle
        across, up = torch.maximum(x.abs(), y.abs()), torch.minimum(x.abs(), y.abs())
        few, source = torch.unique((n - 1 - up) // 2 * n + (n - 1 + across) // 2, return_inverse=True)
        image = torch.zeros_like(pixels)
        for which in range(_IMAGES):
            cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[which // 2]
            flipped = (1 - 2 * (which % 2)) * up
            image[(cosine * across - sine * flipped == x) & (sine * across + cosine * flipped == y)] = which
        return MirrorImages(few, source, image)


def azimuths_of_images(places: int) -> Tensor:
    """(8, A) int64: where the azimuths (n + 1/2) 2 pi / A are in every image, modulo A."""
    n = torch.arange(places)
    return torch.stack([(n if which % 2 == 0 else -1 - n) + which // 2 * places // 4 for which in range(_IMAGES)])
