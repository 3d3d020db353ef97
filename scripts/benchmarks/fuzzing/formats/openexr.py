"""OpenEXR: every compression and pixel type, tiles, several parts, deep and subsampled channels, odd windows."""

import struct
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from fuzzing.files import InputFile
from fuzzing.mutations import mutated_bytes, packed_number

_COMPRESSIONS = "NO RLE ZIPS ZIP PIZ PXR24 B44 B44A DWAA DWAB HTJ2K256 HTJ2K32".split()
_DEEP, _MULTIPART = 0x800, 0x1000
_NAMES = (
    b"channels", b"compression", b"dataWindow", b"displayWindow", b"lineOrder", b"pixelAspectRatio", b"chromaticities",
    b"screenWindowWidth", b"tiles", b"type", b"name", b"version", b"chunkCount", b"envmap", b"preview", b"view",
    b"multiView", b"whiteLuminance", b"adoptedNeutral", b"maxSamplesPerPixel",
)  # fmt: skip
_TYPES = (
    b"box2i", b"box2f", b"chlist", b"compression", b"chromaticities", b"double", b"envmap", b"float", b"int",
    b"keycode", b"lineOrder", b"m33f", b"m44f", b"preview", b"rational", b"string", b"stringvector", b"tiledesc",
    b"timecode", b"v2i", b"v2f", b"v3i", b"v3f", b"unknown",
)  # fmt: skip

Attribute = tuple[bytes, bytes, bytes]
"""Name, type and value."""


def seeds() -> list[InputFile]:
    """Files of 8 x 16 pixels, but for some."""
    import OpenEXR as exr

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "seed.exr")
        files: dict[str, bytes] = {}

        def write(name: str, *parts: tuple[Mapping[str, Any], Mapping[str, Any]]) -> None:
            try:
                made = [exr.Part(dict(part[0]), dict(part[1]), f"part {i}") for i, part in enumerate(parts)]
                with exr.File(made) if len(made) > 1 else exr.File(*map(dict, parts[0])) as file:
                    file.write(str(path))
                files[name] = path.read_bytes()
            except (RuntimeError, ValueError, TypeError) as error:
                raise ValueError(f"the installed OpenEXR cannot write {name!r}: {error}") from None

        colours = {name: _plane(8, 16, i) for i, name in enumerate("RGB")}
        half = {name: plane.astype(np.float16) for name, plane in colours.items()}
        scanlines, tiles = {"type": exr.scanlineimage}, {"type": exr.tiledimage, "tiles": _tiles(exr)}
        for name in _COMPRESSIONS:
            if (compression := getattr(exr, f"{name}_COMPRESSION", None)) is None:
                continue
            for kind, header in (("lines", scanlines), ("tiles", tiles)):
                write(f"{name} {kind}", ({**header, "compression": compression}, half if kind == "lines" else colours))
        plain = {**scanlines, "compression": exr.ZIP_COMPRESSION}
        whole = {name: (plane * 100).astype(np.uint32) for name, plane in colours.items()}
        noise = {name: np.random.default_rng(i).random((8, 16), np.float32) for i, name in enumerate("RGB")}
        write("whole numbers", (plain, whole))
        write("noise", (plain, noise))
        write("alpha and depth", (plain, {**half, "A": half["R"], "Z": colours["G"]}))
        write("one channel", (plain, {"Y": colours["R"]}))
        write("lower case", (plain, {name.lower(): plane for name, plane in colours.items()}))
        write("layer", (plain, {f"beauty.{name}": plane for name, plane in colours.items()}))
        write("layers", (plain, {f"{layer}.{name}": half[name] for layer in ("a", "b") for name in "RGB"}))
        write("normals", (plain, {name: plane - 0.5 for name, plane in half.items()}))
        write("square", (plain, {name: plane[:, :8].copy() for name, plane in half.items()}))
        write("infinite", (plain, {**half, "R": np.full((8, 16), np.inf, np.float16)}))
        write("cropped", ({**plain, **_windows((2, 3, 17, 10), (0, 0, 31, 15))}, half))
        write("overscan", ({**plain, **_windows((-2, -1, 13, 6), (0, 0, 7, 3))}, half))
        write("disjoint", ({**plain, **_windows((100, 100, 115, 107), (0, 0, 7, 7))}, half))
        primaries = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
        write("primaries", ({**plain, "chromaticities": primaries, "note": "text", "pixelAspectRatio": 1.0}, half))
        write("decreasing", ({**plain, "lineOrder": exr.DECREASING_Y}, half))
        write("two parts", (plain, {"Z": colours["R"]}), (plain, half))
        write("parts of both kinds", ({**tiles, "compression": exr.ZIP_COMPRESSION}, half), (plain, {"A": half["R"]}))
        deep = np.empty((4, 4), object)
        for i in np.ndindex(deep.shape):
            deep[i] = np.arange(sum(i) % 3 + 1, dtype=np.float32)
        for storage in (exr.deepscanline, exr.deeptile):
            header = {
                **(tiles if storage == exr.deeptile else {}),
                "type": storage,
                "compression": exr.ZIPS_COMPRESSION,
            }
            write(storage.name, (header, dict.fromkeys("RGBAZ", deep)))
    files["luminance and chroma"] = _luminance_and_chroma()
    return [InputFile(name, ".exr", content) for name, content in files.items()]


def mutated(content: bytes, rng: Random, others: Sequence[bytes]) -> bytes:
    """Change attributes of the header, with offsets that go along, so that decoders are reached; or what follows it."""
    version, headers, end = _parsed(content)
    body = content[end:]
    if rng.random() < 0.3:
        return content[:end] + mutated_bytes(body, rng, others)
    if rng.random() < 0.05:
        version ^= 1 << rng.choice((0, 1, 9, 10, 11, 12, 13, 31))
    header = rng.choice(headers)
    where = rng.randrange(len(header))
    name, kind, value = header[where]
    match rng.randrange(10):
        case 0:
            del header[where]
        case 1:
            header.insert(rng.randrange(len(header) + 1), header[where])
        case 2:
            header[where] = (rng.choice(_NAMES), kind, value)
        case 3:
            header[where] = (name, rng.choice(_TYPES), value)
        case 4:
            header[where] = (name, kind, mutated_bytes(value, rng, [attribute[2] for attribute in header])[:5000])
        case 5:
            foreign = rng.choice(_parsed(rng.choice(others))[1])
            header.insert(where, rng.choice(foreign))
        case 6:
            names = [attribute[0] for attribute in header]
            at = names.index(rng.choice((b"dataWindow", b"displayWindow")))
            header[at] = (*header[at][:2], _moved_window(header[at][2], rng))
        case 7:
            at = [attribute[0] for attribute in header].index(b"channels")
            header[at] = (*header[at][:2], _mutated_channels(header[at][2], rng))
        case _:
            numbers = [value[i : i + 4] for i in range(0, len(value), 4)]
            numbers[rng.randrange(len(numbers))] = packed_number(rng, 4, "<")
            header[where] = (name, kind, b"".join(numbers))
    encoded = _encoded(version, headers)
    return encoded + _moved_offsets(body, end, len(encoded) - end)


def _luminance_and_chroma() -> bytes:
    """Half of 8 x 16 pixels, chroma at every other of them: the Python module does not write such a file."""
    sampled = ((b"BY", 2), (b"RY", 2), (b"Y", 1))
    channels = b"".join(name + b"\0" + struct.pack("<IB3xii", 1, 0, step, step) for name, step in sampled) + b"\0"
    window = struct.pack("<4i", 0, 0, 15, 7)
    header = [
        (b"channels", b"chlist", channels), (b"compression", b"compression", b"\0"), (b"dataWindow", b"box2i", window),
        (b"displayWindow", b"box2i", window), (b"lineOrder", b"lineOrder", b"\0"),
        (b"pixelAspectRatio", b"float", struct.pack("<f", 1)), (b"screenWindowCenter", b"v2f", bytes(8)),
        (b"screenWindowWidth", b"float", struct.pack("<f", 1)),
    ]  # fmt: skip
    encoded = _encoded(2, [header])
    offsets, lines = b"", b""
    for y in range(8):
        pixels = b"".join(np.full(16 // step, 0.5, "<f2").tobytes() for _, step in sampled if y % step == 0)
        offsets += struct.pack("<Q", len(encoded) + 8 * 8 + len(lines))
        lines += struct.pack("<ii", y, len(pixels)) + pixels
    return encoded + offsets + lines


def _tiles(exr: Any) -> Any:
    tiles = exr.TileDescription()
    tiles.xSize, tiles.ySize = 8, 4
    return tiles


def _plane(height: int, width: int, channel: int) -> np.ndarray:
    """(height, width) float32 above 0, smooth, so that every compression keeps to its own path."""
    y, x = np.mgrid[:height, :width]
    return ((x + 2 * y + channel) / (width + 2 * height) + 0.01).astype(np.float32)


def _windows(data: tuple[int, ...], view: tuple[int, ...]) -> dict[str, Any]:
    """The two windows, each x0, y0, x1, y1."""
    both = {"dataWindow": data, "displayWindow": view}
    return {name: (np.array(box[:2], np.int32), np.array(box[2:], np.int32)) for name, box in both.items()}


def _parsed(content: bytes) -> tuple[int, list[list[Attribute]], int]:
    """Version and flags, the attributes of each part, and where they end."""
    _, version = struct.unpack_from("<II", content)
    at, headers = 8, []
    while True:
        header: list[Attribute] = []
        while content[at] != 0:
            name, _, rest = content[at : at + 512].partition(b"\0")
            kind = rest.partition(b"\0")[0]
            at += len(name) + len(kind) + 2
            (size,) = struct.unpack_from("<I", content, at)
            if at + 4 + size >= len(content):
                raise ValueError("an attribute reaches beyond the file")
            header.append((name, kind, content[at + 4 : at + 4 + size]))
            at += 4 + size
        at += 1
        if header:
            headers.append(header)
        if not (header and version & _MULTIPART):
            return version, headers, at


def _encoded(version: int, headers: list[list[Attribute]]) -> bytes:
    encoded = struct.pack("<II", 20000630, version)
    for header in headers:
        for name, kind, value in header:
            encoded += name + b"\0" + kind + b"\0" + struct.pack("<I", len(value)) + value
        encoded += b"\0"
    return encoded + b"\0" * bool(version & _MULTIPART)


def _moved_offsets(body: bytes, end: int, shift: int) -> bytes:
    """What follows the headers when they grow: the table of offsets lies before the first chunk that it names."""
    if len(body) < 8 or shift == 0:
        return body
    size = struct.unpack_from("<Q", body)[0] - end
    if not 0 < size <= len(body) or size % 8:
        return body
    offsets = struct.unpack_from(f"<{size // 8}Q", body)
    return struct.pack(f"<{len(offsets)}Q", *((offset + shift) % (1 << 64) for offset in offsets)) + body[size:]


def _moved_window(value: bytes, rng: Random) -> bytes:
    corners = list(struct.unpack("<4i", value))
    for _ in range(rng.choice((1, 1, 2))):
        where = rng.randrange(4)
        step = rng.choice((-1, 1, -7, 8, 100, -100, 5000, 1 << 15, 1 << 20, 1 << 30, -(1 << 31)))
        corners[where] = max(-(1 << 31), min(corners[where] + step, (1 << 31) - 1))
    return struct.pack("<4i", *corners)


def _mutated_channels(value: bytes, rng: Random) -> bytes:
    """One channel of a list (name, pixel type, linear, x and y sampling) left out, doubled, renamed or made another."""
    channels, at = [], 0
    while value[at] != 0:
        name = value[at : value.index(b"\0", at)]
        channels.append([name, *struct.unpack_from("<IB3xii", value, at + len(name) + 1)])
        at += len(name) + 17
    where = rng.randrange(len(channels))
    match rng.randrange(5):
        case 0:
            del channels[where]
        case 1:
            channels.insert(where, list(channels[where]))
        case 2:
            channels[where][0] = rng.choice((*b"R G B A Y RY r a.R . \x1b[1m".split(), b"N" * 255))
        case 3:
            channels[where][1] = rng.choice((0, 1, 2, 3, 255, (1 << 32) - 1))
        case _:
            channels[where][rng.choice((3, 4))] = rng.choice((0, -1, 2, 3, 16, 1 << 20, -(1 << 31), (1 << 31) - 1))
    if rng.random() < 0.5:
        channels.sort()
    return b"".join(name + b"\0" + struct.pack("<IB3xii", *rest) for name, *rest in channels) + b"\0"
