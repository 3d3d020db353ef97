"""JPEG: grey and colour, baseline and progressive, turned by EXIF."""

import struct
from collections.abc import Sequence
from random import Random

import numpy as np

from fuzzing.files import InputFile
from fuzzing.mutations import mutated_bytes, packed_number

_ENTROPY_CODED = 0xDA


def seeds() -> list[InputFile]:
    """Files of 8 x 16 pixels."""
    import cv2

    colour = np.random.default_rng(0).integers(0, 255, (8, 16, 3), dtype=np.uint8)
    files = {}
    for name, pixels, options in (
        ("colour", colour, []),
        ("grey", colour[..., 0].copy(), []),
        ("square", colour[:, :8].copy(), []),
        ("progressive", colour, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]),
        ("restarts", colour, [cv2.IMWRITE_JPEG_RST_INTERVAL, 1]),
        ("all chroma", colour, [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]),
    ):
        files[name] = cv2.imencode(".jpg", pixels, options)[1].tobytes()
    for turn in (1, 3, 6, 8, 9):
        exif = b"Exif\0\0MM\0*\0\0\0\x08\0\1\x01\x12\0\3\0\0\0\1" + struct.pack(">HHI", turn, 0, 0)
        files[f"orientation {turn}"] = files["colour"][:2] + _segment(0xE1, exif) + files["colour"][2:]
    return [InputFile(name, ".jpeg" if i % 2 else ".jpg", content) for i, (name, content) in enumerate(files.items())]


def mutated(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """Change, drop or double a segment; lengths agree again."""
    at, segments = 2, []
    while content[at] == 0xFF and content[at + 1] != _ENTROPY_CODED:
        (size,) = struct.unpack_from(">H", content, at + 2)
        segments.append((content[at + 1], content[at + 4 : at + 2 + size]))
        at += 2 + size
    where = rng.randrange(len(segments))
    kind, held = segments[where]
    match rng.randrange(6):
        case 0:
            del segments[where]
        case 1:
            segments.insert(rng.randrange(len(segments) + 1), segments[where])
        case 2:
            segments[where] = (rng.choice((0xC0, 0xC1, 0xC2, 0xC4, 0xDB, 0xDD, 0xE0, 0xE1, 0xE2, 0xEE, 0xFE)), held)
        case 3:
            frame = next(i for i, (name, _) in enumerate(segments) if 0xC0 <= name <= 0xC2)
            held = segments[frame][1]
            field = rng.choice((1, 3))
            segments[frame] = (segments[frame][0], held[:field] + packed_number(rng, 2, ">") + held[field + 2 :])
        case 4:
            return content[:at] + mutated_bytes(content[at:], rng, others)
        case _:
            segments[where] = (kind, mutated_bytes(held, rng, [held for _, held in segments])[:60000])
    return content[:2] + b"".join(_segment(*segment) for segment in segments) + content[at:]


def _segment(kind: int, held: bytes) -> bytes:
    return bytes((0xFF, kind)) + struct.pack(">H", len(held) + 2) + held
