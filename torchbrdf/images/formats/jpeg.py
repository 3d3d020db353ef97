"""JPEG: eight bits, by convention sRGB where no profile says otherwise."""

import io
from pathlib import Path

from torchbrdf.images.encodings import SRGB
from torchbrdf.images.formats._colour_profile import colours_of_profile
from torchbrdf.images.formats._integers import decoded, orientation_of
from torchbrdf.images.formats._stored import Stored, unreadable
from torchbrdf.images.primaries import SPACES

SUFFIXES = (".jpg", ".jpeg")

_ERRORS = (OSError, ValueError, SyntaxError, LookupError, TypeError)
"""What Pillow raises for damaged files."""


def read(path: Path) -> Stored:
    """Values over their full scale; raises ValueError for damaged files and encodings that are not known."""
    from PIL import Image

    data = path.read_bytes()
    try:
        with Image.open(io.BytesIO(data), formats=["JPEG"]) as image:
            exif, profile = image.info.get("exif", b""), image.info.get("icc_profile")
    except _ERRORS:
        raise unreadable(path, "JPEG") from None
    transfer, primaries = colours_of_profile(path, profile) if profile else (SRGB, SPACES["rec709"])
    return decoded(path, data, "JPEG", transfer, primaries).turned(orientation_of(exif))
