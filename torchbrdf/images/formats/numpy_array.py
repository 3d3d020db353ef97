"""NumPy arrays, `.npy`: (H, W), (H, W, 3), or (3, H, W) as PyTorch has them."""

from pathlib import Path

import numpy as np

from torchbrdf.files import printable
from torchbrdf.images.formats._integers import of_integers
from torchbrdf.images.formats._stored import MAX_PIXELS, Stored, unreadable

KIND = "NumPy array"
SUFFIXES = (".npy",)
SIGNATURES = (b"\x93NUMPY",)


def read(path: Path) -> Stored:
    """Floating-point values, or integers; raises ValueError where two axes could be that of the channels."""
    with open(path, "rb") as file:
        beginning = file.read(12)
    length = int.from_bytes(beginning[8 : 10 if beginning[6:7] == b"\1" else 12], "little")
    if length > path.stat().st_size:  # NumPy asks for that much memory first
        raise unreadable(path, KIND)
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception:  # its parser of headers raises errors of many kinds
        raise unreadable(path, KIND) from None
    rows = _rows(path, array)
    if array.dtype.kind == "b":
        return of_integers(rows * np.uint8(255), KIND)
    if array.dtype.kind in "ui":
        return of_integers(_narrowed(path, rows), KIND)
    if array.dtype.kind != "f":
        raise ValueError(f"{path}: holds values of the type {printable(str(array.dtype))}; write floating-point ones")
    with np.errstate(over="ignore"):
        planes = np.array(rows.transpose(2, 0, 1), dtype=np.float32, order="C")
    return Stored(planes[:3], KIND, alpha=planes[3] if len(planes) > 3 else None)


def _rows(path: Path, array: np.ndarray) -> np.ndarray:
    """(H, W, C)."""
    first, last = (array.ndim == 3 and array.shape[axis] in (1, 3, 4) for axis in (0, 2))
    if first and last:
        what = f"has shape {array.shape}: its first or its last axis may be the channels"
        raise ValueError(f"{path}: {what}; write it as .exr")
    if array.ndim == 2:
        array = array[..., None]
    elif first:
        array = array.transpose(1, 2, 0)
    elif not last:
        raise ValueError(f"{path}: has shape {array.shape}; a picture needs (H, W, 3) or (3, H, W), a mask (H, W)")
    if not 1 <= array[..., 0].size <= MAX_PIXELS:
        raise unreadable(path, KIND, f"shape {array.shape}")
    return array


def _narrowed(path: Path, array: np.ndarray) -> np.ndarray:
    """Integers as 8 or 16 unsigned bits: wider ones as 8 where they fit, as labels do."""
    if array.dtype.kind == "u" and array.dtype.itemsize <= 2:
        return array
    if array.min() < 0 or array.max() > 255:
        ends = f"{array.dtype} values from {array.min()} to {array.max()}"
        raise ValueError(f"{path}: holds {ends}; write floating-point ones, or uint16")
    return array.astype(np.uint8)
