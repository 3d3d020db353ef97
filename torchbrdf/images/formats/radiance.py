"""Radiance pictures, `.hdr` and `.pic`, as Radiance's own text defines them [War22].

Values are radiance: what is stored over all EXPOSURE and COLORCORR lines, which tell what a program has multiplied it
by. Many readers leave that out. A mantissa m counts as m, as in all other readers, where Radiance's own code takes
m + 1/2. Without PRIMARIES the colours are said to be none in particular.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite, prod
from pathlib import Path

import numpy as np

from torchbrdf.files import printable
from torchbrdf.images.formats._stored import MAX_PIXELS, Colours, Stored, check_pixel_aspect, unreadable
from torchbrdf.images.primaries import Primaries

KIND = "Radiance .hdr"
SUFFIXES = (".hdr", ".pic")
SIGNATURES = (b"#?",)

_LONGEST_HEADER = 1 << 20
_RESOLUTION = re.compile(rb"\s*([+-])([XY])\s*(\d{1,9})\s+([+-])([XY])\s*(\d{1,9})\s*")
_BLANK_LINE = re.compile(rb"(?:\A|\n)\r*\n")
_RUN_LENGTHS = range(8, 1 << 15)
"""Widths whose scanlines may be stored in the newer way, each component by itself."""

_XYZE = "32-bit_rle_xyze"
_PLACES = {"EXPOSURE": 1, "PIXASPECT": 1, "COLORCORR": 3, "PRIMARIES": 8}
"""Variables whose numbers count, and how many each has."""


@dataclass(frozen=True)
class _Header:
    """What stands before the pixels: variables, the axes of the scanlines and their lengths, where pixels begin."""

    variables: list[tuple[str, str]]
    axes: tuple[str, str]
    lengths: tuple[int, int]
    end: int


def read(path: Path) -> Stored:
    """The radiance in a file; raises ValueError for other files, damage, XYZE and pixels that are not square."""
    data = path.read_bytes()
    header = _header(path, data)
    for key, value in header.variables:
        if key == "FORMAT" and value != "32-bit_rle_rgbe":
            what = "CIE XYZ without a white; convert it with `ra_xyze -r`" if value == _XYZE else "not RGB; convert it"
            raise ValueError(f"{path}: its pixel format is {value[:40]!r}, {what}")
    numbers = {key: list(_numbers(path, key, header)) for key in _PLACES}
    check_pixel_aspect(path, prod([ratio[0] for ratio in numbers["PIXASPECT"]]))
    count, width = header.lengths
    rgbe = _pixels(path, data, header.end, count, width)
    step = np.ldexp(np.float32(1), np.arange(256) - 136)
    step[0] = 0
    values = rgbe[..., :3] * step[rgbe[..., 3:]]
    values, about = _over(path, values, [*numbers["EXPOSURE"], *numbers["COLORCORR"]])
    return Stored(
        _upright(values, header.axes).transpose(2, 0, 1).copy(),  # torch takes no negative strides
        KIND,
        colours=lambda: _colours(path, numbers["PRIMARIES"]),
        about=about,
    )


def _over(path: Path, values: np.ndarray, factors: list[tuple[float, ...]]) -> tuple[np.ndarray, str]:
    """Values (..., 3) over the product of factors, for all channels or for each, and what was done."""
    with np.errstate(all="ignore"):
        product = np.prod([np.broadcast_to(factor, 3) for factor in factors], axis=0) * np.ones(3)
        if (product == 1).all():
            return values, ""
        values = (values / product).astype(np.float32)
    numbers = " ".join(f"{number:g}" for number in (product[:1] if len(set(product)) == 1 else product))
    if not (np.isfinite(product).all() and np.isfinite(values).all()):
        raise ValueError(f"{path}: EXPOSURE and COLORCORR multiply to {numbers}: no radiance; mend its header")
    return values, f"values over EXPOSURE and COLORCORR, {numbers}"


def _colours(path: Path, primaries: list[tuple[float, ...]]) -> Colours:
    try:
        return Colours(primaries=Primaries.of(primaries[-1]) if primaries else None)
    except ValueError as error:
        raise ValueError(f"{path}: PRIMARIES: {error}") from None


def _header(path: Path, data: bytes) -> _Header:
    if data.startswith(b"ENVI"):
        raise ValueError(f"{path}: is the header of an ENVI data set, no picture; write that as .exr")
    blank = _BLANK_LINE.search(data, 0, _LONGEST_HEADER)
    if blank is None:
        raise unreadable(path, KIND, "no blank line ends its header")
    found = data.find(b"\n", blank.end(), blank.end() + 100)
    match = _RESOLUTION.fullmatch(data, blank.end(), max(found, blank.end()))
    if match is None or match[2] == match[5]:
        raise unreadable(path, KIND, "no resolution, such as -Y 512 +X 1024, follows its header")
    lengths = int(match[3]), int(match[6])
    if not 1 <= lengths[0] * lengths[1] <= MAX_PIXELS:
        raise unreadable(path, KIND, f"it claims {lengths[0]} x {lengths[1]} pixels")
    variables = []
    for line in data[: blank.start()].decode("latin-1").split("\n"):
        key, equals, value = line.partition("=")
        if equals and not line[0].isspace():  # indented lines tell of pictures that this one was made from
            variables.append((key.strip(), value.strip()))
    axes = (match[1] + match[2]).decode(), (match[4] + match[5]).decode()
    return _Header(variables, axes, lengths, found + 1)


def _numbers(path: Path, key: str, header: _Header) -> Iterator[tuple[float, ...]]:
    """The numbers of every line of a variable; factors of 0 count as 1."""
    for name, text in header.variables:
        if name != key:
            continue
        words = text.split()[: _PLACES[key]]
        try:
            numbers = tuple(float(word) for word in words)
        except ValueError:
            numbers = ()
        factors = key != "PRIMARIES"
        sound = len(numbers) == _PLACES[key] and all(isfinite(n) and not (factors and n < 0) for n in numbers)
        if not sound:
            line = printable(f"{key}={text[:60]}")
            raise ValueError(f"{path}: {line} in its header must be {_PLACES[key]} numbers; mend that line")
        yield tuple(n or 1.0 for n in numbers) if factors else numbers


def _upright(values: np.ndarray, axes: tuple[str, str]) -> np.ndarray:
    """Scanlines (count, length, 3) as rows from the top: axes are those of the scanlines' order, and of each one."""
    if axes[0] == "+Y" or axes[0] == "-X":
        values = values[::-1]
    if axes[1] == "+Y" or axes[1] == "-X":
        values = values[:, ::-1]
    return values.swapaxes(0, 1) if axes[0][1] == "X" else values


def _pixels(path: Path, data: bytes, position: int, count: int, width: int) -> np.ndarray:
    """(count, width, 4) uint8: mantissas and exponents of all scanlines, however each is stored."""
    if count > (len(data) - position) // 4:
        raise unreadable(path, KIND, "truncated")
    lines = []
    try:
        for _ in range(count):
            if _newer(data, position, width):
                line, position = _by_component(data, position + 4, width)
            else:
                line, position = _by_pixel(data, position, width)
            lines.append(line)
    except IndexError:
        raise unreadable(path, KIND, f"truncated or damaged in scanline {len(lines)} of {count}") from None
    return np.stack(lines)


def _newer(data: bytes, position: int, width: int) -> bool:
    """Whether a scanline is stored by component; IndexError where it says so, of another width."""
    start = data[position : position + 4]
    if width not in _RUN_LENGTHS or start[:2] != b"\2\2" or start[2] > 127:
        return False
    if start != bytes((2, 2, width >> 8, width & 255)):
        raise IndexError
    return True


def _by_component(data: bytes, position: int, width: int) -> tuple[np.ndarray, int]:
    """One scanline (width, 4) of runs of each component, and where the next one begins; IndexError for damage."""
    line = bytearray()
    for component in range(1, 5):
        end = component * width
        while len(line) < end:
            code = data[position]
            if code > 128:
                line += data[position + 1 : position + 2] * (code - 128)
                position += 2
            else:
                line += data[position + 1 : position + 1 + code]
                position += 1 + code
                if code == 0:
                    raise IndexError
            if position > len(data):
                raise IndexError
        if len(line) > end:
            raise IndexError
    return np.frombuffer(line, np.uint8).reshape(4, width).T, position


def _by_pixel(data: bytes, position: int, width: int) -> tuple[np.ndarray, int]:
    """One scanline (width, 4) of pixels, and where the next one begins; IndexError for damage.

    (1, 1, 1, n) repeats the pixel before n times; the k-th in a row of them 256^k n times.
    """
    flat = np.frombuffer(data, np.uint8, min(4 * width, len(data) - position) // 4 * 4, position).reshape(-1, 4)
    if len(flat) == width and not (flat[:, :3] == 1).all(axis=1).any():
        return flat, position + 4 * width
    line = bytearray()
    shift, end = 0, 4 * width
    while len(line) < end:
        pixel = data[position : position + 4]
        position += 4
        if pixel[:3] == b"\1\1\1":
            times = pixel[3] << shift
            shift += 8
            if not line or times > width:
                raise IndexError
            line += line[-4:] * times
        else:
            if len(pixel) < 4:
                raise IndexError
            line += pixel
            shift = 0
    if len(line) > end:
        raise IndexError
    return np.frombuffer(line, np.uint8).reshape(width, 4), position
