"""Pictures of integers, and the orientation that EXIF data name."""

import struct
import warnings
from collections.abc import Callable

import numpy as np

from torchbrdf.images.formats._stored import Colours, Stored

_ORIENTATION = 0x0112


def of_integers(pixels: np.ndarray, kind: str, colours: Callable[[], Colours] = Colours, bits: int = 0) -> Stored:
    """From (H, W) or (H, W, C) unsigned integers: grey or R, G, B, and perhaps alpha.

    bits  of which the numbers are made; 0 for all that their type has
    """
    bits = bits or 8 * pixels.dtype.itemsize
    full_scale = (1 << bits) - 1
    planes = np.atleast_3d(pixels).transpose(2, 0, 1).astype(np.float32, order="C") / np.float32(full_scale)
    count = 3 if len(planes) >= 3 else 1
    alpha = planes[count] if len(planes) > count else None
    return Stored(planes[:count], f"{bits}-bit {kind}", alpha=alpha, full_scale=full_scale, colours=colours)


def orientation_of(exif: bytes) -> int:
    """The orientation, 1 to 8, that a block of EXIF data names; 1 where it names none."""
    from PIL import Image

    found = Image.Exif()
    try:
        with warnings.catch_warnings(action="ignore"):
            found.load(exif)
        return int(found.get(_ORIENTATION, 1))
    except (OSError, ValueError, SyntaxError, LookupError, TypeError, ArithmeticError, struct.error):
        return 1
