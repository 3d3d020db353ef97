"""Formats that are a short text and then numbers: PFM and NumPy's `.npy`."""

import io
from collections.abc import Sequence
from random import Random

import numpy as np

from fuzzing.files import InputFile
from fuzzing.mutations import mutated_bytes, mutated_text

_TYPES = ("f2", "<f4", ">f4", "<f8", "u1", "u2", "c8")
_LONGEST_HEADER = 4096


def pfm_seeds() -> list[InputFile]:
    """Colour and grey, both byte orders."""
    pixels = np.random.default_rng(0).random((8, 16, 3))
    files = {
        "little-endian": b"PF\n16 8\n-1.0\n" + pixels.astype("<f4").tobytes(),
        "big-endian": b"PF\n16 8\n1.0\n" + pixels.astype(">f4").tobytes(),
        "scaled": b"PF 16 8 -0.5\n" + pixels.astype("<f4").tobytes(),
        "grey": b"Pf\n16 8\n-1.0\n" + pixels[..., 0].astype("<f4").tobytes(),
        "crlf": b"PF\r\n16 8\r\n-1.0\n" + pixels.astype("<f4").tobytes(),
        "comment": b"PF\n# made\n16 8\n-1.0\n" + pixels.astype("<f4").tobytes(),
        "square": b"PF\n8 8\n-1.0\n" + pixels[:, :8].astype("<f4").tobytes(),
    }
    return [InputFile(name, ".pfm", content) for name, content in files.items()]


def pfm_mutated(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """Change the three lines of the header, or the pixels."""
    end = content[:_LONGEST_HEADER].rindex(b"\n", 0, 40) + 1
    if rng.random() < 0.3:
        return content[:end] + mutated_bytes(content[end:], rng, others)
    return mutated_text(content[:end], rng, others) + content[end:]


def npy_seeds() -> list[InputFile]:
    """Both layouts, several types, both orders, every version of the format; one that only pickle reads."""
    pixels = np.random.default_rng(0).random((8, 16, 3))
    arrays: dict[str, np.ndarray] = {dtype: pixels.astype(dtype) for dtype in _TYPES}
    arrays |= {
        "channels first": pixels.transpose(2, 0, 1).astype("f4"), "Fortran's order": np.asfortranarray(pixels, "f4"),
        "grey": pixels[..., 0].astype("f4"), "alpha": np.ones((8, 16, 4), "f4"), "square": pixels[:, :8].astype("f4"),
        "scalar": np.array(1.0), "empty": np.zeros((0, 8, 3)), "fields": np.zeros((8, 16), "f4,f4,f4"),
        "objects": np.array([[1, None]], dtype=object), "text": np.array(["a", "b"]),
    }  # fmt: skip
    files = {}
    for name, array in arrays.items():
        held = io.BytesIO()
        np.save(held, array)
        files[name] = held.getvalue()
    for version in ((2, 0), (3, 0)):
        held = io.BytesIO()
        np.lib.format.write_array(held, pixels.astype("f4"), version)
        files[f"version {version[0]}"] = held.getvalue()
    return [InputFile(name, ".npy", content) for name, content in files.items()]


def npy_mutated(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """Change the dictionary of the header, its length kept or not, or the numbers."""
    end = content.index(b"\n") + 1
    if rng.random() < 0.3:
        return content[:end] + mutated_bytes(content[end:], rng, others)
    spaced = content[10:end].replace(b"(", b"( ").replace(b",", b" ,").replace(b")", b" )")
    header = mutated_text(spaced, rng, others)
    if rng.random() < 0.8:
        return content[:8] + (len(header) & 0xFFFF).to_bytes(2, "little") + header + content[end:]
    return content[:10] + header.ljust(end - 10)[: end - 10] + content[end:]
