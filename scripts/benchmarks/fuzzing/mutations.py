"""Mutations of bytes, of text and of JSON: what formats do not know of themselves."""

import json
import math
import re
import struct
import zlib
from collections.abc import Callable, Sequence
from random import Random
from typing import Any

LONGEST = 1 << 17
"""Bytes that a mutated content may have: repeated chunks must not grow without end."""

WHOLE_NUMBERS = (
    0, 1, -1, 2, 3, 4, 7, 8, 16, 127, 128, -128, 255, 256, 1023, 4096, 32767, 32768, -32768, 65535, 65536, 1 << 20,
    1 << 24, 1 << 28, (1 << 28) + 1, (1 << 30) - 1, 1 << 30, (1 << 31) - 1, 1 << 31, -(1 << 31), (1 << 32) - 1, 1 << 32,
    (1 << 53) + 1, (1 << 62) + 3, (1 << 63) - 1, 1 << 63, (1 << 64) - 1,
)  # fmt: skip
REAL_NUMBERS = (0.0, -0.0, 1.0, -1.0, 1e-45, 1e-38, 1e30, 3.4e38, -3.4e38, 1e300, math.inf, -math.inf, math.nan)

TOKENS = [
    *(str(number).encode() for number in WHOLE_NUMBERS),
    *b"0.0 -0.0 .5 1. 1e9 1e38 3.5e38 1e39 1e308 1e309 -1e309 1e-50 nan -nan inf -inf NaN Infinity 1.#INF".split(),
    *b"1_0 1,5 0x7f".split(),
    *b"+ - -- / // 1/ /1 1//1 1/2/3/4 # % %s%n = == : ; \\ \" ' ( ) [] {} true null".split(),
    b"", b"\0", b"\x1b[31m", b"\xff\xfe", "½".encode(), "٣".encode(), b"9" * 40, b"9" * 5000, b"A" * 127, b"A" * 300,
]  # fmt: skip

ODD_JSON: tuple[Any, ...] = (
    None, True, False, *WHOLE_NUMBERS, 0.5, -1.5, 1e300, math.nan, math.inf, "", "a", "0", "\0", "\x1b[2J", "é\n",
    "A" * 300, [], {}, [0], [[]], [-1, 2], [1 << 62, 1 << 62], {"a": 1}, [None], ["a", 1],
)  # fmt: skip
DEEP_JSON = b"[" * 3000 + b"]" * 3000

_INAPPLICABLE = (
    ValueError, LookupError, TypeError, AttributeError, StopIteration, RecursionError, struct.error, zlib.error,
)  # fmt: skip
"""What mutations of a format raise where an earlier mutation took away what they need."""


FormatMutation = Callable[[bytes, Random, Sequence[bytes]], bytes]
"""content, random numbers, contents of other files of the format -> content; ValueError where it does not apply."""


def mutated(content: bytes, rng: Random, others: Sequence[bytes], of_format: FormatMutation) -> bytes:
    """One mutation (three in four times) or more on top of each other, over half of them such as the format knows."""
    for _ in range(1 + min(int(rng.expovariate(1.4)), 6)):
        if rng.random() < 0.6:
            try:
                content = of_format(content, rng, others)[:LONGEST]
                continue
            except _INAPPLICABLE:
                pass
        content = mutated_bytes(content, rng, others)[:LONGEST]
    return content


def mutated_bytes(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """One mutation of any bytes."""
    return rng.choice(_OF_BYTES)(content, rng, others)


def _flipped(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    changed = bytearray(content or b"\0")
    for _ in range(1 << rng.randrange(4)):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _replaced(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    changed = bytearray(content or b"\0")
    for _ in range(1 << rng.randrange(4)):
        changed[rng.randrange(len(changed))] = rng.choice((0, 1, 10, 32, 127, 128, 255, rng.randrange(256)))
    return bytes(changed)


def _with_number(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    number = packed_number(rng, rng.choice((1, 2, 4, 4, 8)))
    where = rng.randrange(max(len(content) - len(number), 0) + 1)
    if rng.random() < 0.8:
        where -= where % len(number)
    return content[:where] + number + content[where + len(number) :]


def _without_chunk(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    start, end = _chunk(content, rng)
    return content[:start] + content[end:]


def _with_chunk_again(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    start, end = _chunk(content, rng)
    where = rng.choice((end, rng.randrange(len(content) + 1)))
    return content[:where] + content[start:end] * rng.choice((1, 1, 2, 50)) + content[where:]


def _with_inserted(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    where, count = rng.randrange(len(content) + 1), rng.choice((1, 2, 4, 8, 64, 1000))
    inserted = rng.choice((bytes(count), b"\xff" * count, rng.randbytes(count)))
    return content[:where] + inserted + content[where:]


def _with_foreign_chunk(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    other = rng.choice(others)
    start, end = _chunk(other, rng)
    where = rng.choice((start, rng.randrange(len(content) + 1)))
    return content[:where] + other[start:end] + content[where + rng.choice((0, end - start)) :]


def _spliced(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    other = rng.choice(others)
    start = rng.randrange(len(content) + 1)
    return content[:start] + other[rng.choice((start, rng.randrange(len(other) + 1))) :]


def _truncated(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    return content[: rng.choice((rng.randrange(len(content) + 1), max(len(content) - 1 - rng.randrange(8), 0)))]


_OF_BYTES: tuple[FormatMutation, ...] = (
    _flipped, _flipped, _replaced, _replaced, _with_number, _with_number, _with_number, _without_chunk,
    _with_chunk_again, _with_inserted, _with_foreign_chunk, _spliced, _truncated,
)  # fmt: skip


def _chunk(content: bytes, rng: Random) -> tuple[int, int]:
    start = rng.randrange(len(content) + 1)
    return start, min(start + (1 << rng.randrange(10)), len(content))


def packed_number(rng: Random, size: int, order: str = "") -> bytes:
    """A telling whole or real number in 1, 2, 4 or 8 bytes."""
    order = order or rng.choice("<>")
    if size >= 4 and rng.random() < 0.2:
        number = rng.choice(REAL_NUMBERS)
        try:
            return struct.pack(order + {4: "f", 8: "d"}[size], number)
        except OverflowError:
            return struct.pack(order + "f", float("inf"))
    whole = rng.choice(WHOLE_NUMBERS) & ((1 << 8 * size) - 1)
    return whole.to_bytes(size, "little" if order == "<" else "big")


def mutated_text(text: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """One mutation of lines of words."""
    if rng.random() < 0.35:
        return _mutated_lines(text, rng, others)
    parts = re.split(rb"([ \t\r\n=]+)", text)
    words = [i for i, part in enumerate(parts) if part and i % 2 == 0]
    where = rng.choice(words)
    match rng.randrange(8):
        case 0:
            parts[where] = parts[rng.choice(words)]
        case 1:
            parts[where] = rng.choice(rng.choice(others)[:2000].split() or [b""])
        case 2:
            parts[where] = mutated_bytes(parts[where], rng, others)[:50]
        case 3:
            parts[where] += b" " + rng.choice(TOKENS)
        case _:
            parts[where] = rng.choice(TOKENS)
    return b"".join(parts)


def _mutated_lines(text: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    lines = text.splitlines(keepends=True)
    where = rng.randrange(len(lines))
    match rng.randrange(7):
        case 0:
            del lines[where]
        case 1:
            lines.insert(rng.randrange(len(lines) + 1), lines[where])
        case 2:
            lines[where:where] = [lines[where]] * rng.choice((2, 10, 300))
        case 3:
            lines.insert(where, lines.pop(rng.randrange(len(lines))))
        case 4:
            foreign = rng.choice(others)[:4000].splitlines(keepends=True)
            lines.insert(where, rng.choice(foreign or [b"\n"]))
        case 5:
            ends = (b"\r\n", b"\r", b"\\\n", b"\n\n", b" \n", b"", b"\0\n")
            lines[where] = lines[where].rstrip(b"\r\n") + rng.choice(ends)
        case _:
            end = rng.choice((b"\r\n", b"\r", b"\n"))
            lines = [line.rstrip(b"\r\n") + end for line in lines]
    return b"".join(lines)


def mutated_json(text: bytes, rng: Random) -> bytes:
    """One mutation of a JSON document: a value, a key or an entry anywhere in it."""
    if rng.random() < 0.01:
        return DEEP_JSON
    document = json.loads(text)
    places = list(_places(document))
    holder, key = rng.choice(places)
    match rng.randrange(6):
        case 0:
            del holder[key]
        case 1:
            other, its = rng.choice(places)
            holder[key] = json.loads(json.dumps(other[its]))
        case 2 if isinstance(holder, dict):
            holder[rng.choice(("", "a", *holder, *(str(its) for _, its in places)))] = holder.pop(key)
        case 3 if isinstance(holder, list):
            holder.extend([holder[key]] * rng.choice((1, 2, 100)))
        case 4 if isinstance(holder[key], (int, float)):
            value = holder[key]
            holder[key] = rng.choice((value + 1, value - 1, -value, value * 2, value * 1000))
        case _:
            holder[key] = rng.choice(ODD_JSON)
    return json.dumps(document).encode()


def _places(document: Any) -> Any:
    """Every entry below a document, as (what holds it, its key there)."""
    keys = list(document) if isinstance(document, dict) else range(len(document)) if isinstance(document, list) else ()
    for key in keys:
        yield document, key
        yield from _places(document[key])
