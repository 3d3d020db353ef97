"""Portable float maps: a text header, then rows from the bottom.

A negative scale says that the bytes are little-endian.
"""

import re
from pathlib import Path

import numpy as np

from torchbrdf.images.formats._stored import MAX_PIXELS, Stored, unreadable

KIND = "PFM"
SUFFIXES = (".pfm",)
SIGNATURES = (b"PF\n", b"Pf\n", b"PF\r\n", b"Pf\r\n")

_HEADER = re.compile(rb"(P[Ff])\s+(\d{1,9})\s+(\d{1,9})\s+([-+.\deE]+)[ \t]*\r?\n")


def read(path: Path) -> Stored:
    """The radiance in a file; raises ValueError for damage and for scales that programs read in different ways."""
    data = path.read_bytes()
    header = _HEADER.match(data)
    if header is None:
        raise unreadable(path, KIND)
    channels, width, height = (3 if header[1] == b"PF" else 1), int(header[2]), int(header[3])
    try:
        scale = float(header[4])
    except ValueError:
        raise unreadable(path, KIND) from None
    if abs(scale) != 1:
        raise ValueError(
            f"{path}: its scale {scale:g} is a factor to some programs, a divisor or nothing to others; write 1 or -1"
        )
    if not 1 <= width * height <= MAX_PIXELS or len(data) < header.end() + 4 * channels * width * height:
        raise unreadable(path, KIND)
    stored = np.frombuffer(data, "<f4" if scale < 0 else ">f4", channels * width * height, header.end())
    rows = stored.reshape(height, width, channels)[::-1]
    return Stored(np.array(rows.transpose(2, 0, 1), dtype=np.float32, order="C"), KIND)
