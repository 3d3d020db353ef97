"""Radiance `.hdr`: RGBE and XYZE, flat, with old and with new run lengths, in all orientations."""

import re
from collections.abc import Sequence
from random import Random

import numpy as np

from fuzzing.files import InputFile
from fuzzing.mutations import mutated_bytes, mutated_text

_SIGNATURE = b"#?RADIANCE\n"
_FORMAT = b"FORMAT=32-bit_rle_rgbe\n"
_ODD_LINES = (
    b"EXPOSURE=4\n", b"EXPOSURE= 0.5\n", b"EXPOSURE=0\n", b"EXPOSURE=-1\n", b"EXPOSURE=nan\n", b"EXPOSURE=1e-40\n",
    b"COLORCORR=1 2 3\n", b"COLORCORR=0 0 0\n", b"PRIMARIES=.64 .33 .3 .6 .15 .06 .3127 .329\n",
    b"PRIMARIES=0 0 0 0 0 0 0 0\n", b"PRIMARIES=1 0 0 1 0 0 .333 .333\n", b"PIXASPECT=2\n", b"PIXASPECT=0\n",
    b"FORMAT=32-bit_rle_xyze\n", b"FORMAT=32-bit_rle_rgbe\n", b"FORMAT=\n", b"GAMMA=2.2\n", b"VIEW= -vtv\n",
    b"A" * 126 + b"\n", b"A" * 127 + b"\n", b"A" * 254 + b"\n", b"A" * 5000 + b"\n", b"pfilt -e 1\n", b"\r\n", b"\n",
)  # fmt: skip


def seeds() -> list[InputFile]:
    """Files of 4 x 8 to 16 x 32 pixels."""
    small, wide = _pixels(4, 8), _pixels(16, 32)
    files = {
        "flat": _SIGNATURE + _FORMAT + b"\n-Y 4 +X 8\n" + small.tobytes(),
        "new run lengths": _SIGNATURE + _FORMAT + b"\n-Y 16 +X 32\n" + _new_run_lengths(wide),
        "old run lengths": _SIGNATURE + _FORMAT + b"\n-Y 4 +X 8\n" + _old_run_lengths(small),
        "xyze": _SIGNATURE + b"FORMAT=32-bit_rle_xyze\n\n-Y 16 +X 32\n" + _new_run_lengths(wide),
        "no format": _SIGNATURE + b"\n-Y 4 +X 8\n" + small.tobytes(),
        "no signature": _FORMAT + b"\n-Y 4 +X 8\n" + small.tobytes(),
        "crlf": b"#?RGBE\r\nFORMAT=32-bit_rle_rgbe\r\n\r\n-Y 4 +X 8\r\n" + small.tobytes(),
        "exposure": _SIGNATURE + b"# made\nEXPOSURE=2\nEXPOSURE= .5\nCOLORCORR=1 1 1\n" + _FORMAT
        + b"PIXASPECT=1\nPRIMARIES=.64 .33 .3 .6 .15 .06 .3127 .329\n\n-Y 16 +X 32\n" + _new_run_lengths(wide),
        "square": _SIGNATURE + _FORMAT + b"\n-Y 16 +X 16\n" + _new_run_lengths(wide[:, :16]),
    }  # fmt: skip
    for first in "+-":
        for second in "+-":
            upright, turned = f"\n{first}Y 4 {second}X 8\n", f"\n{first}X 32 {second}Y 16\n"
            files[upright.strip()] = _SIGNATURE + _FORMAT + upright.encode() + small.tobytes()
            files[turned.strip()] = _SIGNATURE + _FORMAT + turned.encode() + _new_run_lengths(_pixels(32, 16))
    made = [InputFile(name, ".hdr", content) for name, content in files.items()]
    return [*made, InputFile(".pic", ".pic", files["new run lengths"])]


def mutated(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """Change a line of the header, the resolution, or the pixels behind it."""
    found = re.search(rb"\n\r?\n[^\n]*\n", content)
    end = found.end() if found else min(len(content), 100)
    header, pixels = content[:end], content[end:]
    match rng.randrange(4):
        case 0:
            lines = header.splitlines(keepends=True)
            lines.insert(rng.randrange(max(len(lines) - 1, 1)), rng.choice(_ODD_LINES))
            return b"".join(lines) + pixels
        case 1 if found:
            return header[: found.start()] + mutated_text(header[found.start() :], rng, others) + pixels
        case 2:
            return header + mutated_bytes(pixels, rng, others)
        case _:
            return mutated_text(header, rng, others) + pixels


def _pixels(height: int, width: int) -> np.ndarray:
    """(height, width, 4) mantissas and exponents; runs in the lower half."""
    pixels = np.random.default_rng(height).integers(1, 255, (height, width, 4), dtype=np.uint8)
    pixels[..., 3] = 126 + pixels[..., 3] % 5
    pixels[height // 2 :] = pixels[0, 0]
    return pixels


def _new_run_lengths(pixels: np.ndarray) -> bytes:
    rows = bytearray()
    for row in pixels:
        rows += bytes((2, 2, len(row) >> 8, len(row) & 255))
        for component in row.T:
            if (component == component[0]).all():
                rows += bytes((128 + len(component), component[0]))
            else:
                rows += bytes((len(component),)) + component.tobytes()
    return bytes(rows)


def _old_run_lengths(pixels: np.ndarray) -> bytes:
    """A pixel of mantissas 1, 1, 1 repeats the pixel before it."""
    rows = bytearray()
    for row in pixels:
        if (row == row[0]).all():
            rows += row[0].tobytes() + bytes((1, 1, 1, len(row) - 1))
        else:
            rows += row.tobytes()
    return bytes(rows)
