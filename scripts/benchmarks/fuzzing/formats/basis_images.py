"""Safetensors with a few texts: basis images, finished and unfinished, as torchbrdf writes them and as it does not."""

import json
import struct
from collections.abc import Sequence
from random import Random
from typing import Any

import numpy as np

from fuzzing.files import InputFile
from fuzzing.mutations import mutated_bytes, mutated_json, mutated_text

UNFINISHED_IDENTITY, UNFINISHED_SHAPE = "library probe view 64 0", (3, 4, 6)

_LENGTH = struct.Struct("<Q")
_TYPES = ("BOOL", "U8", "I8", "F8_E4M3", "I16", "U16", "F16", "BF16", "I32", "F32", "F64", "I64", "U64", "C64", "X")
_SHAPES: tuple[list[int], ...] = ([], [0], [1], [6, 3, 4], [4, 18], [72], [288], [1, 2, 3], [6], [6, 1], [1 << 62, 4])


def seeds() -> list[InputFile]:
    """Two materials, six pixels of which four are used."""
    mask = np.array([[[1, 0, 1], [1, 1, 0]]], np.uint8)
    packed = np.arange(6 * 3 * 4, dtype="<f4").reshape(6, 3, 4)
    errors = np.full(6, 0.01, "<f4")
    texts = {
        "format": "torchbrdf basis images 1", "names": '["brass", "näve\\n"]', "normal_coverage": "0.5", "library": "L",
        "probe": "P", "view": "V", "description": "made",
    }  # fmt: skip
    tensors = {"packed": ("F32", packed), "mask": ("BOOL", mask)}
    with_errors = {**tensors, "relative_errors": ("F32", errors)}
    old = {key: text for key, text in texts.items() if key != "normal_coverage"}
    files = {
        "plain": _file(texts, tensors),
        "errors": _file(texts, with_errors),
        "coverage not given": _file(old, tensors),
        "double": _file(texts, {**tensors, "packed": ("F64", packed.astype("<f8"))}),
        "half": _file(texts, {**tensors, "packed": ("F16", packed.astype("<f2"))}),
        "other tensors": _file(texts, {**with_errors, "more": ("F32", errors)}),
        "no texts": _file({}, tensors),
        "mask of numbers": _file(texts, {**tensors, "mask": ("U8", mask)}),
        "mask of no truth values": _file(texts, {**tensors, "mask": ("BOOL", 3 * mask)}),
        "not a number": _file(texts, {**tensors, "packed": ("F32", packed * np.nan)}),
    }
    return [InputFile(name, ".safetensors", content) for name, content in files.items()]


def unfinished_seeds() -> list[InputFile]:
    """The state of a bake of six images of four pixels."""
    texts = {"format": "torchbrdf unfinished basis images 1", "identity": UNFINISHED_IDENTITY}
    mean = np.arange(3 * 4 * 6, dtype="<f4").reshape(UNFINISHED_SHAPE)
    tensors = {"mean": ("F32", mean), "spread": ("F64", np.ones(6)), "counts": ("I64", np.array([64, 8]))}
    files = {
        "plain": _file(texts, tensors),
        "one count": _file(texts, {**tensors, "counts": ("I64", np.array(64))}),
        "no pass": _file(texts, {**tensors, "counts": ("I64", np.array([0, 0]))}),
        "another bake": _file({**texts, "identity": "other"}, tensors),
    }
    return [InputFile(name, ".unfinished", content) for name, content in files.items()]


def mutated(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """Change the header, with its length right again but for some; the texts in it; or the numbers."""
    (size,) = _LENGTH.unpack_from(content)
    header, numbers = content[8 : 8 + size], content[8 + size :]
    match rng.choice((0, 0, 0, 1, 1, 1, 2, 3, 4, 4)):
        case 0:
            return content[: 8 + size] + mutated_bytes(numbers, rng, others)
        case 1:
            held = json.loads(header)
            texts = held["__metadata__"]
            key = rng.choice(list(texts))
            if key == "names" and rng.random() < 0.5:
                texts[key] = mutated_json(texts[key].encode(), rng).decode()
            else:
                words = [text.encode() for text in texts.values()]
                texts[key] = mutated_text(texts[key].encode(), rng, words).decode("latin1")
            header = json.dumps(held).encode()
        case 2:
            held = json.loads(header)
            key = rng.choice([key for key in held if key != "__metadata__"])
            held[key]["dtype"] = rng.choice(_TYPES)
            if rng.random() < 0.5:
                held[key]["shape"] = rng.choice(_SHAPES)
            header = json.dumps(held).encode()
        case 3:
            header = mutated_bytes(header, rng, others)
        case _:
            header = mutated_json(header, rng)
    length = rng.choice((len(header),) * 19 + (rng.choice((0, len(header) - 1, 1 << 30, (1 << 64) - 1)),))
    return _LENGTH.pack(max(length, 0)) + header + numbers


def _file(texts: dict[str, str], tensors: dict[str, tuple[str, np.ndarray]]) -> bytes:
    header: dict[str, Any] = {"__metadata__": texts} if texts else {}
    numbers = b""
    for name, (kind, array) in tensors.items():
        start = len(numbers)
        numbers += array.tobytes()
        header[name] = {"dtype": kind, "shape": array.shape, "data_offsets": [start, len(numbers)]}
    text = json.dumps(header).encode()
    return _LENGTH.pack(len(text)) + text + numbers
