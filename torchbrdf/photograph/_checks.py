"""Whether photographs and their masks are what the room takes."""

import torch
from torch import Tensor


def check_photograph(image: Tensor, mask: Tensor | None) -> None:
    """Raise ValueError where it is no tensor (3, H, W) of floating-point numbers, or for a mask as `check_mask`."""
    if not isinstance(image, Tensor):
        raise ValueError(f"image must be a tensor (3, H, W), got {type(image).__name__}; see torch.from_numpy")
    if image.ndim != 3 or image.shape[0] != 3:
        advice = "; permute it: image.movedim(-1, -3)" if image.ndim == 3 and image.shape[2] == 3 else ""
        raise ValueError(f"image must be (3, H, W), got {tuple(image.shape)}{advice}")
    if not image.is_floating_point():
        raise ValueError(
            f"image must hold linear floating-point radiance, got {image.dtype}; decode the file, "
            "torchbrdf.read_image(path, allow_ldr=True)"
        )
    if mask is not None:
        check_mask(mask, image.shape[1], image.shape[2])


def check_mask(mask: Tensor, height: int, width: int) -> None:
    """Raise ValueError where a mask is no tensor (1, H, W) bool of a photograph's H and W."""
    if not isinstance(mask, Tensor):
        raise ValueError(f"mask must be a tensor of bool, got {type(mask).__name__}; see torch.from_numpy")
    shape = tuple(mask.shape)
    if mask.dtype != torch.bool or len(shape) != 3 or shape[0] != 1:
        raise ValueError(f"mask must be bool {(1, height, width)}, got {mask.dtype} {shape}")
    if shape != (1, height, width):
        raise ValueError(
            f"mask must have the size of the photograph, {height} x {width}, got {shape[1]} x {shape[2]}"
        )
