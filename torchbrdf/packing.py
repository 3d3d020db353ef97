"""Images packed over the pixels of a mask, row by row, and back."""

import torch
from torch import Tensor


def masked_pixels(mask: Tensor) -> Tensor:
    """(P,) int64: flat indices of the True pixels of a mask (1, H, W), row by row."""
    return torch.nonzero(mask.ravel()).ravel()


def pack(image: Tensor, mask: Tensor) -> Tensor:
    """The pixels under a mask (1, H, W): (..., H, W) -> (..., P)."""
    return image.flatten(-2)[..., masked_pixels(mask).to(image.device)]


def unpack(packed: Tensor, mask: Tensor) -> Tensor:
    """The inverse of `pack`, 0 outside the mask: (..., P) -> (..., H, W)."""
    image = packed.new_zeros(*packed.shape[:-1], mask.numel())
    return image.index_copy(-1, masked_pixels(mask).to(packed.device), packed).unflatten(-1, mask.shape[-2:])
