"""Photographs as the estimator takes them: checked, and packed over the pixels of their basis images."""

import warnings
from collections.abc import Sequence

import torch
from torch import Tensor

from torchbrdf.view import Frames

_TOGETHER = 64
"""Photographs solved at a time: temporaries of more leave the processor's cache."""


def check_observation(
    image: Tensor | Sequence[Tensor], mask: Tensor | Sequence[Tensor | None] | None, frames: Frames, several: bool
) -> tuple[Tensor, Tensor, torch.Size]:
    """Pack photographs and the pixels to use.

    image, mask  as `BRDFEstimator.forward` takes them
    several      whether sequences are expected
    returns      y (B, 3, P) in the precision of the photographs, 0 where not used; used (B, P) bool; the batch axes
    """
    images = list(image) if several and not isinstance(image, Tensor) else [image]
    masks = list(mask) if isinstance(mask, Sequence) else [mask] * len(images)
    if len(images) != len(frames.masks) or len(masks) != len(images):
        raise ValueError(
            f"this estimator takes {len(frames.masks)} photographs of one material, with as many masks or none; "
            f"got {len(images)} and {len(masks)}"
        )
    checked = []
    for one, its_mask, frame in zip(images, masks, frames.masks, strict=True):
        if not isinstance(one, Tensor):
            raise ValueError(f"image must be a tensor (*batch, 3, H, W), got {type(one).__name__}")
        checked.append(_check_one(one, its_mask, frame))
    ys, useds, batches = zip(*checked, strict=True)
    batch = batches[0]
    if any((its_batch, y.dtype) != (batch, ys[0].dtype) for y, its_batch in zip(ys, batches, strict=True)):
        raise ValueError("the photographs of one material must share batch axes and precision")
    y = torch.cat(ys, -1) if len(ys) > 1 else ys[0]
    used = torch.cat(useds, -1) if len(useds) > 1 else useds[0]
    try:
        kept = y if bool(used.all()) else torch.where(used[:, None], y, 0)
        _check_values(y, kept, used)
    except RuntimeError as error:
        if "vmap" in str(error):
            raise RuntimeError("torch.func.vmap is not supported: pass the whole batch (*batch, 3, H, W)") from None
        raise
    return kept, used, batch


def groups_by_mask(used: Tensor) -> list[Tensor]:
    """Rows of used (B, P) that are the same, at most _TOGETHER of them."""
    if bool((used == used[:1]).all()):
        rows = [torch.arange(len(used), device=used.device)]
    else:
        masks, group = torch.unique(used, dim=0, return_inverse=True)
        rows = [torch.nonzero(group == k).ravel() for k in range(len(masks))]
    return [some for those in rows for some in those.split(_TOGETHER) if len(some)]


def _check_one(image: Tensor, mask: Tensor | None, frame: Tensor) -> tuple[Tensor, Tensor, torch.Size]:
    size = frame.shape[-2:]
    if image.ndim < 3 or image.shape[-3] != 3 or image.shape[-2:] != size:
        advice = "; permute it: image.movedim(-1, -3)" if image.shape[-3:] == (*size, 3) else ""
        raise ValueError(
            f"image must be (*batch, 3, {size[0]}, {size[1]}) like the basis images, got {tuple(image.shape)}{advice}"
        )
    if image.dtype not in (torch.float32, torch.float64):
        raise ValueError(f"image must be float32 or float64 linear radiance, got {image.dtype}")
    batch = image.shape[:-3]
    packing = Frames((frame,))
    y = packing.pack([image.reshape(-1, 3, *size)]).contiguous()
    shapes = dict.fromkeys([(1, *size), (*batch, 1, *size)])  # of a single photograph they are one
    if mask is None:
        used = torch.ones_like(y[:, 0], dtype=torch.bool)
    elif not isinstance(mask, Tensor):
        raise ValueError(f"mask must be a tensor of bool, got {type(mask).__name__}; see torch.from_numpy")
    elif mask.dtype == torch.bool and tuple(mask.shape) in shapes:
        used = packing.pack([mask.reshape(-1, *size).to(image.device)]).expand(len(y), -1)
    else:
        raise ValueError(f"mask must be bool {' or '.join(map(str, shapes))}, got {mask.dtype} {tuple(mask.shape)}")
    return y, used, batch


def _check_values(y: Tensor, kept: Tensor, used: Tensor) -> None:
    known = kept.detach()
    largest = known.abs().amax((-2, -1))
    signed = (known / largest[:, None, None]).square() * known.sign()
    negative = torch.nonzero(signed.sum((-2, -1)) < 0).ravel().tolist()
    if negative:
        warnings.warn(
            f"photograph {negative[0]} of {len(y)} is mostly negative, which no radiance is: do not trust the result; "
            "see whether too much was subtracted from it, or its sign changed",
            UserWarning,
            stacklevel=2,
        )
    if bool(((largest > 0) & (largest < float("inf"))).all()):
        return
    values = y.detach()
    unsound = int((~torch.isfinite(values).all(1) & used).sum())
    if unsound:
        raise ValueError(f"image holds {unsound} NaN or infinite pixels under the mask; mask them out")
    empty = torch.nonzero(~used.any(1)).ravel().tolist()
    if empty:
        raise ValueError(f"mask leaves no pixel of the view to use in photograph {empty[0]} of {len(y)}")
    black = torch.nonzero(~((values != 0) & used[:, None]).any(-1).any(-1)).ravel().tolist()
    if black:
        raise ValueError(f"photograph {black[0]} of {len(y)} is black: every pixel under the mask is 0")
