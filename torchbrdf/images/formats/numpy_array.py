"""NumPy arrays, `.npy`: (H, W, 3), or (3, H, W) as PyTorch has them."""

from pathlib import Path

import numpy as np

from torchbrdf.images.formats._stored import MAX_PIXELS, Stored, unreadable

SUFFIXES = (".npy",)

_KIND = "NumPy .npy"


def read(path: Path) -> Stored:
    """Floating-point values; raises ValueError for other arrays, and where two axes could be that of the channels."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError, SyntaxError, TypeError, OverflowError, MemoryError):
        raise unreadable(path, _KIND) from None
    if array.dtype.kind not in "fb":
        raise ValueError(f"{path}: holds {array.dtype} values; a picture needs linear floating-point ones")
    first, last = (array.ndim == 3 and array.shape[axis] in (1, 3, 4) for axis in (0, 2))
    if array.ndim == 2:
        planes = array[None]
    elif first != last:
        planes = array if first else array.transpose(2, 0, 1)
    else:
        raise ValueError(f"{path}: has shape {array.shape}; a picture needs (H, W, 3) or (3, H, W)")
    if not 1 <= planes[0].size <= MAX_PIXELS:
        raise unreadable(path, _KIND)
    count = min(len(planes), 3)
    values = np.array(planes, dtype=np.float32)
    return Stored(values[:count], _KIND, alpha=values[3] if len(values) > 3 else None)
