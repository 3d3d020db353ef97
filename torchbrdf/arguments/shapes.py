"""Tensors of another shape than a call takes."""

from torch import Tensor


def check_last(values: Tensor, size: int, what: str) -> None:
    """Raise ValueError where the last axis of values (..., size) has another size.

    what  they are, as the message calls them
    """
    if values.ndim == 0 or values.shape[-1] != size:
        raise ValueError(f"{what} must be (..., {size}), got {tuple(values.shape)}")
