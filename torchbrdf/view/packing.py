"""Images packed over the pixels of a mask, row by row, and back."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor


def masked_pixels(mask: Tensor) -> Tensor:
    """(P,) int64: flat indices of the True pixels of a mask (1, H, W), row by row."""
    return torch.nonzero(mask.ravel()).ravel()


def pack(image: Tensor, mask: Tensor) -> Tensor:
    """The pixels under a mask (1, H, W): (..., H, W) -> (..., P). Raises ValueError for an image of another size."""
    if image.shape[-2:] != mask.shape[-2:]:
        height, width = mask.shape[-2:]
        raise ValueError(f"an image to pack must be (..., {height}, {width}) as the mask is, got {tuple(image.shape)}")
    pixels = masked_pixels(mask).to(image.device)
    flat = image.flatten(-2)
    return flat.gather(-1, pixels.expand(*flat.shape[:-1], -1))  # four times faster than an index


def unpack(packed: Tensor, mask: Tensor) -> Tensor:
    """The inverse of `pack`, 0 outside the mask: (..., P) -> (..., H, W). Raises ValueError for another P."""
    pixels = masked_pixels(mask).to(packed.device)
    if packed.shape[-1:] != pixels.shape:
        raise ValueError(f"values to unpack must be (..., {len(pixels)}) of this mask, got {tuple(packed.shape)}")
    image = packed.new_zeros(*packed.shape[:-1], mask.numel())
    return image.index_copy_(-1, pixels, packed).unflatten(-1, mask.shape[-2:])


@dataclass(frozen=True, eq=False)
class Frames:
    """Where the pixels of one or several photographs lie when they are packed one behind the other.

    masks  one (1, H, W) bool for each photograph
    """

    masks: tuple[Tensor, ...]

    @property
    def sizes(self) -> list[int]:
        """The number of packed pixels of each."""
        return [int(mask.sum()) for mask in self.masks]

    def pack(self, images: Sequence[Tensor]) -> Tensor:
        """(*batch, C, H, W) of each photograph -> (*batch, C, P)."""
        # torch.compile before 2.10 cannot break its graph within a zip that is strict.
        pairs = list(zip(images, self.masks, strict=True))
        return torch.cat([pack(image, mask) for image, mask in pairs], dim=-1)

    def unpack(self, packed: Tensor) -> tuple[Tensor, ...]:
        """The inverse of `pack`, 0 outside the masks."""
        parts = packed.split(self.sizes, dim=-1)
        return tuple(unpack(part, mask) for part, mask in zip(parts, self.masks, strict=True))
