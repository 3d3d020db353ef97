"""Photographs as the estimator takes them: checked, and packed over the pixels of their basis images."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchbrdf.arguments import warn
from torchbrdf.view import Frames

_DECODE = (
    "pictures of whole numbers are encoded for displays, and dividing by 255 does not make them linear: decode the "
    "file, torchbrdf.read_image(path, allow_ldr=True)"
)

_DIVERGED = 0.9
"""Share of a photograph's pixels that are not finite from which no mask helps."""

_NAMED = 3
"""Photographs of a batch that a message tells."""

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
    images = _each(image, len(frames.masks), several)
    masks = list(mask) if isinstance(mask, Sequence) else [mask] * len(images)
    if len(masks) != len(images):
        raise ValueError(f"expected a mask or None for each of {len(images)} photographs, got {len(masks)}")
    checked = []
    for one, its_mask, frame in zip(images, masks, frames.masks, strict=True):
        if not isinstance(one, Tensor):
            advice = "; see torch.from_numpy" if isinstance(one, np.ndarray) else ""
            raise ValueError(f"image must be a tensor (*batch, 3, H, W), got {type(one).__name__}{advice}")
        checked.append(_check_one(one, its_mask, frame))
    ys, useds, batches = zip(*checked, strict=True)
    batch = batches[0]
    if any((its_batch, y.dtype) != (batch, ys[0].dtype) for y, its_batch in zip(ys, batches, strict=True)):
        raise ValueError("the photographs of one material must share batch axes and precision")
    y = torch.cat(ys, -1) if len(ys) > 1 else ys[0]
    used = torch.cat(useds, -1) if len(useds) > 1 else useds[0]
    try:
        kept = y if bool(used.all()) else torch.where(used[:, None], y, 0)
        _check_values(y, kept, used, batch, frames)
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


def _each(image: Any, count: int, several: bool) -> list[Any]:
    """The photographs, of which there must be as many as basis images; what each is, `_check_one` checks."""
    listed = not isinstance(image, Tensor) and isinstance(image, Iterable)
    if not several:
        if isinstance(image, list | tuple):
            raise ValueError(
                f"image must be one tensor (*batch, 3, H, W), got a {type(image).__name__} of {len(image)}; several "
                "photographs of one material need an estimator of as many basis images"
            )
        return [image]
    images = list(image) if listed else []
    if len(images) != count:
        got = str(len(images)) if listed else f"one {type(image).__name__}"
        raise ValueError(
            f"this estimator is of {count} photographs of one material: pass a list of {count}, one for each basis, "
            f"got {got}"
        )
    return images


def _check_one(image: Tensor, mask: Tensor | None, frame: Tensor) -> tuple[Tensor, Tensor, torch.Size]:
    size = frame.shape[-2:]
    if image.ndim < 3 or image.shape[-3] != 3 or image.shape[-2:] != size:
        advice = "; permute it: image.movedim(-1, -3)" if image.shape[-3:] == (*size, 3) else ""
        raise ValueError(
            f"image must be (*batch, 3, {size[0]}, {size[1]}) like the basis images, got {tuple(image.shape)}{advice}"
        )
    if image.dtype not in (torch.float32, torch.float64):
        advice = "hand it image.float()" if image.is_floating_point() else _DECODE
        raise ValueError(f"image must be float32 or float64 linear radiance, got {image.dtype}; {advice}")
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


def _check_values(y: Tensor, kept: Tensor, used: Tensor, batch: torch.Size, frames: Frames) -> None:
    """Photographs y (B, 3, P), and with 0 where they are not used (B, P); a batch in these axes."""
    known = kept.detach()
    largest = known.abs().amax((-2, -1))
    signed = (known / largest[:, None, None]).square() * known.sign()
    negative = signed.sum((-2, -1)) < 0
    if bool(negative.any()):
        warn(
            f"image is mostly negative{_places(negative, batch)}, which no radiance is: do not trust the result; "
            "see whether too much was subtracted from it, or its sign changed"
        )
    if bool(((largest > 0) & (largest < float("inf"))).all()):
        return
    values = y.detach()
    _check_finite(~torch.isfinite(values).all(1) & used, used, batch, frames.sizes)
    empty = ~used.any(1)
    if bool(empty.any()):
        raise ValueError(f"mask leaves no pixel of the view to use{_places(empty, batch)}")
    black = ~((values != 0) & used[:, None]).any(-1).any(-1)
    if bool(black.any()):
        raise ValueError(f"image is black{_places(black, batch)}: every pixel under the mask is 0")


def _check_finite(unsound: Tensor, used: Tensor, batch: torch.Size, sizes: Sequence[int]) -> None:
    """Raise ValueError where pixels (B, P) that are used are not finite, `sizes` of each photograph of a material.

    Of photographs that hold hardly another, it names these alone.
    """
    parts = list(zip(unsound.split(list(sizes), 1), used.split(list(sizes), 1), strict=True))
    counts, pixels = (torch.stack([part.sum(1) for part in each], 1) for each in zip(*parts, strict=True))  # (B, K)
    found, lost = counts > 0, counts >= _DIVERGED * pixels.clamp_min(1)
    if not bool(found.any()):
        return
    told = lost if bool(lost.any()) else found
    entries = ", ".join(map(str, torch.nonzero(told.any(0)).ravel().tolist()))
    entry = "" if len(sizes) == 1 else f" in entry {entries} of the list"
    raise ValueError(
        f"image holds NaN or infinite values{entry}{_places(told.any(1), batch)}, in {int(counts[told].sum())} of the "
        f"{int(pixels[told].sum())} pixels under the mask; "
        + ("whatever made it has diverged" if bool(lost.any()) else "mask them out")
    )


def _places(which: Tensor, batch: torch.Size) -> str:
    """Where photographs (B,) bool are in the batch, up to a few; nothing of a single photograph."""
    if not batch:
        return ""
    rows = torch.nonzero(which.reshape(batch)).tolist()
    named = ", ".join(str(row[0] if len(row) == 1 else tuple(row)) for row in rows[:_NAMED])
    more = f" and {len(rows) - _NAMED} more" if len(rows) > _NAMED else ""
    return f" at index {named}{more} of a batch of {' x '.join(map(str, batch))}"
