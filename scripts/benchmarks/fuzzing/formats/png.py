"""PNG: every colour type and depth, interlaced or not, and the chunks that say what its numbers mean."""

import struct
import zlib
from collections.abc import Sequence
from random import Random

import numpy as np

from fuzzing.files import InputFile
from fuzzing.mutations import WHOLE_NUMBERS, mutated_bytes, packed_number

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_PASSES = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
_CHROMATICITIES = struct.pack(">8I", 31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000)

Chunk = tuple[bytes, bytes]
"""Kind and what it holds."""


def profile() -> bytes:
    """A small ICC profile: matrix and gamma, as cameras write it."""
    entries = {
        b"rXYZ": _xyz(0.436, 0.222, 0.014), b"gXYZ": _xyz(0.385, 0.717, 0.097), b"bXYZ": _xyz(0.143, 0.061, 0.714),
        b"wtpt": _xyz(0.9642, 1.0, 0.8249),
        **dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), b"curv\x00\x00\x00\x00\x00\x00\x00\x01\x023\x00\x00"),
    }  # fmt: skip
    table, contents, at = b"", b"", 128 + 4 + 12 * len(entries)
    for name, value in entries.items():
        table += name + struct.pack(">II", at + len(contents), len(value))
        contents += value
    size = at + len(contents)
    header = struct.pack(">I4sI4s4s4s", size, b"none", 0x04300000, b"mntr", b"RGB ", b"XYZ ").ljust(36, b"\0") + b"acsp"
    return header.ljust(128, b"\0") + struct.pack(">I", len(entries)) + table + contents


_META: tuple[Chunk, ...] = (
    (b"gAMA", struct.pack(">I", 100000)), (b"gAMA", struct.pack(">I", 45455)), (b"sRGB", b"\0"),
    (b"cHRM", _CHROMATICITIES), (b"sBIT", b"\5\5\5"), (b"bKGD", b"\0\1\0\1\0\1"), (b"tRNS", b"\0\1\0\1\0\1"),
    (b"cICP", b"\1\x0d\0\1"), (b"pHYs", struct.pack(">IIB", 2, 1, 0)), (b"tEXt", b"Title\0text"),
    (b"zTXt", b"Title\0\0" + zlib.compress(b"text" * 50)), (b"iTXt", b"Title\0\1\0en\0\0" + zlib.compress(b"text")),
    (b"eXIf", b"MM\0*\0\0\0\x08\0\1\x01\x12\0\3\0\0\0\1\0\6\0\0\0\0\0\0"), (b"tIME", bytes(7)),
    (b"acTL", struct.pack(">II", 2, 0)), (b"oFFs", bytes(9)), (b"hIST", bytes(32)), (b"PLTE", bytes(range(48))),
    (b"eXIf", b"II*\0\x08\0\0\0\1\0\x12\1\3\0\1\0\0\0\6\0\0\0\0\0\0\0"), (b"sPLT", b"p\0\x08" + bytes(6)),
)  # fmt: skip


def seeds() -> list[InputFile]:
    """Files of 8 x 16 pixels."""
    files = {}
    for colour, depths in _DEPTHS.items():
        for depth in depths:
            for interlaced in (False, True):
                name = f"colour type {colour}, {depth} bits" + ", interlaced" * interlaced
                files[name] = _file(colour, depth, interlaced)
    icc = (b"iCCP", b"camera\0\0" + zlib.compress(profile()))
    for i, meta in enumerate((*_META[:15], icc)):
        files[f"{meta[0].decode()} {i}"] = _file(2, 16 if i % 2 else 8, extra=(meta,))
        files[f"{meta[0].decode()} {i} and alpha"] = _file(6, 8 if i % 2 else 16, extra=(meta,))
    files["transparent palette"] = _file(3, 8, extra=((b"tRNS", bytes(range(200))),))
    files["transparent grey"] = _file(0, 16, extra=((b"tRNS", b"\0\7"),))
    start, (kind, held), end = _parsed(_file(2, 8))
    files["pixels in many chunks"] = _encoded([start, *((kind, held[i : i + 9]) for i in range(0, len(held), 9)), end])
    return [InputFile(name, ".png", content) for name, content in files.items()]


def mutated(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """Change a chunk, the list of chunks or the packed pixels; checksums agree again, so that decoders are reached."""
    chunks = _parsed(content)
    where = rng.randrange(len(chunks))
    kind, held = chunks[where]
    match rng.randrange(9):
        case 0:
            chunks[where] = (kind, mutated_bytes(held, rng, [b""] + [other for _, other in chunks]))
        case 1:
            del chunks[where]
        case 2:
            chunks.insert(rng.randrange(len(chunks) + 1), chunks[where])
        case 3:
            chunks.insert(rng.randrange(1, len(chunks)), rng.choice(_META))
        case 4:
            chunks.insert(where, rng.choice(_parsed(rng.choice(others))))
        case 5:
            held = chunks[0][1]
            size = [packed_number(rng, 4, ">") if rng.random() < 0.5 else held[i : i + 4] for i in (0, 4)]
            chunks[0] = (b"IHDR", b"".join(size) + chunks[0][1][8:])
        case 6:
            header = bytearray(chunks[0][1])
            header[rng.randrange(8, 13)] = rng.choice((0, 1, 2, 3, 4, 6, 8, 16, 32, 255))
            chunks[0] = (b"IHDR", bytes(header))
        case 7:
            sides = [max(rng.choice(WHOLE_NUMBERS) % (1 << rng.randrange(4, 32)), 1) for _ in range(2)]
            chunks[0] = (b"IHDR", struct.pack(">2I", *sides) + chunks[0][1][8:])
        case _:
            at = next(i for i, (name, _) in enumerate(chunks) if name in (b"IDAT", b"iCCP", b"zTXt"))
            name, held = chunks[at]
            label, packed = (b"", held) if name == b"IDAT" else held.split(b"\0\0", 1)
            unpacked = mutated_bytes(zlib.decompress(packed), rng, [bytes(100)])
            chunks[at] = (name, label + b"\0\0" * (name != b"IDAT") + zlib.compress(unpacked))
    return _encoded(chunks, wrong=rng.randrange(len(chunks)) if rng.random() < 0.05 else None)


def _file(colour: int, depth: int, interlaced: bool = False, extra: tuple[Chunk, ...] = ()) -> bytes:
    height, width = 8, 16
    rng = np.random.default_rng(colour * 16 + depth)
    samples = rng.integers(0, min(1 << depth, 4 if colour == 3 else 1 << 16), (height, width, _CHANNELS[colour]))
    passes = [samples[y::dy, x::dx] for x, y, dx, dy in _PASSES] if interlaced else [samples]
    packed = zlib.compress(b"".join(_rows(part, depth) for part in passes if part.size))
    palette = [(b"PLTE", bytes(range(12)))] if colour == 3 else []
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, interlaced)
    early = [chunk for chunk in extra if chunk[0] != b"tRNS"]
    late = [chunk for chunk in extra if chunk[0] == b"tRNS"]
    return _encoded([(b"IHDR", header), *early, *palette, *late, (b"IDAT", packed), (b"IEND", b"")])


def _rows(samples: np.ndarray, depth: int) -> bytes:
    """Rows as PNG packs them, each behind its filter: none and the four others in turn, whatever they then mean."""
    rows = b""
    for i, row in enumerate(samples.reshape(len(samples), -1)):
        if depth == 16:
            packed = row.astype(">u2").tobytes()
        else:
            bits = (row[:, None] >> np.arange(depth - 1, -1, -1)) & 1
            packed = np.packbits(bits.ravel()).tobytes()
        rows += bytes((i % 5,)) + packed
    return rows


def _xyz(*numbers: float) -> bytes:
    return b"XYZ \0\0\0\0" + struct.pack(">3i", *(round(number * 65536) for number in numbers))


def _parsed(content: bytes) -> list[Chunk]:
    at, chunks = len(_SIGNATURE), []
    while at + 12 <= len(content):
        (size,) = struct.unpack_from(">I", content, at)
        chunks.append((content[at + 4 : at + 8], content[at + 8 : at + 8 + size]))
        at += 12 + size
    return chunks


def _encoded(chunks: Sequence[Chunk], wrong: int | None = None) -> bytes:
    """The file; `wrong` counts the chunk whose checksum does not agree."""
    encoded = _SIGNATURE
    for i, (kind, held) in enumerate(chunks):
        checksum = zlib.crc32(kind + held) ^ (i == wrong)
        encoded += struct.pack(">I", len(held)) + kind + held + struct.pack(">I", checksum)
    return encoded
