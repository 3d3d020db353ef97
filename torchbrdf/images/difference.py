"""How far one image is from another."""

import torch
from torch import Tensor


def relative_rms(image: Tensor, reference: Tensor, mask: Tensor | None = None) -> float:
    """|image - reference| / |reference| over all channels of the pixels under the mask.

    image, reference  (..., H, W) of equal shape
    mask              (1, H, W) or (H, W)  bool, True = use; None for all pixels
    Raises ValueError where shapes differ or the reference is 0 or not finite there: then no relative error exists.
    """
    if image.shape != reference.shape:
        raise ValueError(f"images must have equal shapes, got {tuple(image.shape)} and {tuple(reference.shape)}")
    used = torch.ones_like(reference, dtype=torch.bool) if mask is None else mask.expand(reference.shape)
    known = reference[used].double()
    norm = torch.linalg.vector_norm(known)
    if not torch.isfinite(norm) and not torch.isfinite(known).all():
        raise ValueError("the reference image holds NaN or infinite values in pixels used; mask them out")
    if not norm > 0:
        raise ValueError("the reference image is 0 in every pixel used; a relative error needs a reference")
    return float(torch.linalg.vector_norm((image[used] - reference[used]).double()) / norm)
