"""JPEG: eight bits, by convention sRGB where no profile says otherwise."""

import warnings
from pathlib import Path

import numpy as np

from torchbrdf.images.encodings import SRGB
from torchbrdf.images.formats._colour_profile import colours_of_profile
from torchbrdf.images.formats._integers import of_integers, orientation_of
from torchbrdf.images.formats._stored import Colours, Stored, unreadable
from torchbrdf.images.primaries import SPACES

KIND = "JPEG"
SUFFIXES = (".jpg", ".jpeg")
SIGNATURES = (b"\xff\xd8\xff",)

_MOST_PIXELS_A_BYTE = 1024
"""Every block of 8 x 8 pixels takes a bit of Huffman code or more, so that there are 512."""


def read(path: Path) -> Stored:
    """Values over their full scale; raises ValueError for damaged files, and for colours that are no grey or RGB."""
    from PIL import Image

    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path, formats=["JPEG"]) as image:
            if image.width * image.height > _MOST_PIXELS_A_BYTE * path.stat().st_size:
                raise ValueError("truncated")
            exif, profile, mode = image.info.get("exif", b""), image.info.get("icc_profile"), image.mode
            pixels = np.asarray(image)
    except (OSError, ValueError, SyntaxError, LookupError, TypeError, ArithmeticError, MemoryError):
        raise unreadable(path, KIND) from None
    except Image.DecompressionBombError:
        raise unreadable(path, KIND, "too large") from None
    if mode not in ("L", "RGB"):
        raise ValueError(f"{path}: holds {mode} colours; export it as RGB")

    def colours() -> Colours:
        return colours_of_profile(path, profile) if profile else Colours(SRGB, SPACES["rec709"])

    return of_integers(pixels, KIND, colours).turned(orientation_of(exif))


def exif(path: Path) -> bytes:
    """Its block of EXIF data; none where it has none, or is damaged."""
    from PIL import Image

    try:
        with warnings.catch_warnings(action="ignore"), Image.open(path, formats=["JPEG"]) as image:
            found: bytes = image.info.get("exif", b"")
            return found
    except (OSError, ValueError, SyntaxError, LookupError, TypeError, ArithmeticError, Image.DecompressionBombError):
        return b""
