"""A photograph and its mask, from files."""

from __future__ import annotations

import os
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.camera import Ball
from torchbrdf.images import DEFAULT_SPACE, ColourSpace, Encoding, Window, open_mask, read_picture
from torchbrdf.photograph.silhouette import Circle


@dataclass(frozen=True)
class Photograph:
    """What a camera recorded, and which pixels of it may be used.

    image   (3, H, W) float32  linear radiance
    usable  (1, H, W) bool     recorded (none is NaN or infinite there), and marked by the mask
    mask    (1, H, W) bool     what marks the shape: the file given, else the photograph's alpha; None without either
    window  the part that was recorded; None for all
    full    (1, H, W) bool     whole numbers at the largest that the file can hold; None where there are none
    about   how the files were read where they could be read otherwise, for people
    """

    image: Tensor
    usable: Tensor
    mask: Tensor | None = None
    window: Window | None = None
    full: Tensor | None = None
    about: tuple[str, ...] = ()

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.image.shape[-2], self.image.shape[-1]

    @classmethod
    def open(
        cls,
        path: str | os.PathLike[str],
        mask: str | os.PathLike[str] | None = None,
        *,
        invert_mask: bool = False,
        allow_ldr: bool = False,
        layer: str | None = None,
        primaries: ColourSpace = DEFAULT_SPACE,
        encoding: Encoding | None = None,
    ) -> Photograph:
        """Read a photograph, and the mask given, else its alpha.

        invert_mask  the mask marks what is not to be used
        others       as for `read_image`
        Raises as `read_image` and `open_mask`; ValueError where the sizes differ.
        """
        picture = read_picture(path, allow_ldr, layer=layer, primaries=primaries, encoding=encoding)
        about, marked = list(picture.about), None
        if mask is not None:
            found = open_mask(mask)
            marked = ~found.marked if invert_mask else found.marked
            about += [f"the mask is {found.about}"] if found.about else []
            if marked.shape[1:] != picture.image.shape[1:]:
                wanted, got = (f"{one.shape[1]} x {one.shape[2]}" for one in (picture.image, marked))
                raise ValueError(f"{os.fspath(mask)}: mask must have the size of the photograph, {wanted}, got {got}")
        elif invert_mask:
            raise ValueError("--invert-mask needs a mask: give --mask")
        elif picture.alpha is not None:
            marked = picture.alpha > 0.5
            about.append("its alpha is the mask")
        usable = torch.ones_like(picture.image[:1], dtype=torch.bool) if marked is None else marked.clone()
        if picture.window is not None:
            recorded = torch.zeros_like(usable)
            recorded[:, *picture.window.slices] = True
            usable &= recorded
            about.append(f"recorded {picture.window.height} x {picture.window.width} of its pixels")
        bright = usable & (picture.image == torch.inf).any(0, keepdim=True)
        unknown = usable & ~bright & torch.isnan(picture.image).any(0, keepdim=True)
        for left_out, why in ((bright, "infinite (too bright)"), (unknown, "not a number")):
            if left_out.any():  # `merge` marks so what no exposure holds
                usable &= ~left_out
                about.append(f"left out {int(left_out.sum())} pixels that are {why}")
        return cls(picture.image, usable, marked, picture.window, picture.full, tuple(about))

    def clipped_share(self, silhouette: Circle | Ball | None = None) -> float:
        """Of its usable pixels, or of those within a ball's silhouette: how many a camera of whole numbers clipped."""
        used = self.usable if silhouette is None else self.usable & Circle(*silhouette.circle).holds(*self.size)
        return float(self.full[used].float().mean()) if self.full is not None and used.any() else 0.0
