"""MERL tables: 35 MB each, so that nearly all mutations are such as a reader must refuse by header and length alone."""

import struct
from collections.abc import Sequence
from random import Random

from fuzzing.files import InputFile
from fuzzing.mutations import REAL_NUMBERS, mutated_bytes, packed_number
from torchbrdf.brdf import GRID

READ_WHOLE = 0.003
"""Share of the mutated tables whose header and length are right and whose values are not."""

_HEADER = struct.pack("<3i", *GRID)
_LENGTH = len(_HEADER) + 3 * 8 * GRID[0] * GRID[1] * GRID[2]
_SINGLE = len(_HEADER) + 3 * 4 * GRID[0] * GRID[1] * GRID[2]
_LENGTHS = (0, 1, 11, 12, 13, 20, _LENGTH // 2, _LENGTH - 8, _LENGTH - 1, _LENGTH + 1, _SINGLE, 2 * _LENGTH, 1 << 33)
_WIDE = (GRID[0], GRID[1], 2 * GRID[2])


def seeds() -> list[InputFile]:
    """Black tables, by every suffix; one over the whole azimuth."""
    black = InputFile("black", ".binary", _HEADER, _LENGTH)
    wide = InputFile("whole azimuth", ".fullbin", struct.pack("<3i", *_WIDE), 2 * _LENGTH - len(_HEADER))
    return [black, InputFile("capitals", ".BINARY", _HEADER, _LENGTH), wide]


def mutated(seed: InputFile, rng: Random, others: Sequence[InputFile]) -> InputFile:
    """A wrong header or length; for READ_WHOLE of the tables wrong values."""
    name, suffix = seed.name, seed.suffix
    if rng.random() < READ_WHOLE:
        patches = tuple(_patch(seed.size, rng) for _ in range(rng.choice((1, 3, 30))))
        return InputFile(name, suffix, seed.content, seed.length, patches)
    length = rng.choice((*_LENGTHS, seed.size, seed.size, rng.randrange(_LENGTH)))
    header = seed.content
    match rng.randrange(3):
        case 0:
            dimensions = [rng.choice((side, packed_number(rng, 4))) for side in (header[:4], header[4:8], header[8:])]
            header = b"".join(dimensions)
        case 1:
            header = mutated_bytes(header, rng, [b"version https://git-lfs.github.com/spec/v1\n", bytes(12)])
    if length == seed.size and header[:12] == seed.content:
        length -= 1
    return InputFile(name, suffix, header, length)


def _patch(size: int, rng: Random) -> tuple[int, bytes]:
    where = len(_HEADER) + 8 * rng.randrange((size - len(_HEADER)) // 8)
    return where, rng.choice((struct.pack("<d", rng.choice((*REAL_NUMBERS, -1e-3, 1e10))), rng.randbytes(8)))
