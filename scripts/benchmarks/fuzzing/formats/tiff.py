"""TIFF: 8 to 64 bits, whole and real, strips and tiles, both byte orders, compressed, planar, palettes, BigTIFF."""

import io
import struct
from collections.abc import Sequence
from random import Random
from typing import Any

import numpy as np

from fuzzing.files import InputFile
from fuzzing.mutations import mutated_bytes, packed_number

_ORIENTATION = 274
_OPENCV_COMPRESSIONS = {"lzw": 5, "packbits": 32773, "deflate": 8}
_TAGS = (256, 257, 258, 259, 262, 266, 273, 274, 277, 278, 279, 282, 284, 317, 320, 322, 323, 324, 325, 338, 339, 34675)


def seeds() -> list[InputFile]:
    """Files of 8 x 16 pixels."""
    import cv2
    import tifffile

    files = {}

    def write(name: str, pixels: np.ndarray, **options: Any) -> None:
        held = io.BytesIO()
        photometric = "rgb" if pixels.ndim == 3 else "minisblack"
        container = {key: options.pop(key) for key in ("bigtiff", "byteorder") if key in options}
        with tifffile.TiffWriter(held, **container) as file:
            file.write(pixels, **{"photometric": photometric, "metadata": None, **options})
        files[name] = held.getvalue()

    colour = np.random.default_rng(0).random((8, 16, 3)).astype(np.float32)
    for dtype in ("uint8", "uint16", "uint32", "float16", "float32", "float64"):
        full = np.iinfo(dtype).max if dtype.startswith("u") else 1
        pixels = (colour.astype(np.float64) * full).astype(dtype)
        write(dtype, pixels)
        write(f"{dtype}, big-endian", pixels, byteorder=">")
        write(f"{dtype}, grey", pixels[..., 0].copy())
        write(f"{dtype}, zlib", pixels, compression="zlib")
        if dtype in ("uint8", "uint16", "float32"):
            with_alpha = np.concatenate([pixels, pixels[..., :1]], axis=2)
            write(f"{dtype}, alpha", with_alpha, extrasamples=["unassalpha"])
            for name, code in _OPENCV_COMPRESSIONS.items():
                done, encoded = cv2.imencode(".tiff", pixels, [cv2.IMWRITE_TIFF_COMPRESSION, code])
                if done:
                    files[f"{dtype}, {name}"] = encoded.tobytes()
    write("planar", np.ascontiguousarray(colour.transpose(2, 0, 1)), planarconfig="separate")
    write("tiles", np.tile(colour, (2, 2, 1)), tile=(16, 16))
    write("strips", colour, rowsperstrip=2)
    write("bigtiff", colour, bigtiff=True)
    write("turned", colour, extratags=[(_ORIENTATION, "H", 1, 6, True)])
    write("two pages", np.stack([colour, colour]))
    palette = np.random.default_rng(1).integers(0, 65535, (3, 256)).astype(np.uint16)
    write("palette", (colour[..., 0] * 255).astype(np.uint8), photometric="palette", colormap=palette)
    write("one bit", colour[..., 0] > 0.5)
    return [InputFile(name, ".tif" if i % 2 else ".tiff", content) for i, (name, content) in enumerate(files.items())]


def mutated(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """Change an entry of the first directory: its tag, type, count or value; or what stands elsewhere."""
    order = {b"II": "<", b"MM": ">"}[content[:2]]
    big = struct.unpack_from(order + "H", content, 2)[0] == 43
    (start,) = struct.unpack_from(order + ("Q" if big else "I"), content, 8 if big else 4)
    (count,) = struct.unpack_from(order + ("Q" if big else "H"), content, start)
    first, size, word = start + (8 if big else 2), 20 if big else 12, 8 if big else 4
    at = first + size * rng.randrange(min(count, 200))
    match rng.randrange(7):
        case 0:
            field, value = at, struct.pack(order + "H", rng.choice(_TAGS))
        case 1:
            field, value = at + 2, struct.pack(order + "H", rng.choice((0, 1, 2, 3, 4, 5, 11, 12, 13, 16, 18, 255)))
        case 2:
            field, value = at + 4, packed_number(rng, word, order)
        case 3:
            return content[:start] + mutated_bytes(content[start:], rng, others)
        case 4:
            there = first + size * rng.randrange(min(count, 200))
            field, value = at, content[there : there + size]
        case 5:
            value = struct.pack(order + "H", rng.choice((0, 1, 2, 3, 4, 5, 6, 7, 8, 16, 24, 64, 34712, 50000)))
            field = at + 4 + word
        case _:
            field, value = at + 4 + word, packed_number(rng, word, order)
    return content[:field] + value + content[field + len(value) :]
