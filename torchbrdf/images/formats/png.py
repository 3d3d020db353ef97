"""PNG, 8 or 16 bits, with what its chunks say of colours, encoding and orientation [PNG3]."""

import zlib
from pathlib import Path

import numpy as np

from torchbrdf.images.encodings import LINEAR, SRGB, Transfer
from torchbrdf.images.formats._colour_profile import colours_of_profile
from torchbrdf.images.formats._integers import of_integers, orientation_of
from torchbrdf.images.formats._quiet import quiet_decoders
from torchbrdf.images.formats._stored import MAX_PIXELS, Colours, Stored, unreadable
from torchbrdf.images.primaries import SPACES, Primaries

KIND = "PNG"
SUFFIXES = (".png",)
SIGNATURES = (b"\x89PNG\r\n\x1a\n",)

_CODED_TRANSFERS = {8: LINEAR, 13: SRGB}
_CODED_SPACES = {1: SPACES["rec709"], 9: SPACES["rec2020"], 12: SPACES["p3-d65"]}
"""Code points of ITU-T H.273, as a cICP chunk holds them."""

_LARGEST_PROFILE = 1 << 24


def read(path: Path) -> Stored:
    """Values over their full scale; raises ValueError for damaged files."""
    import imagecodecs

    data = path.read_bytes()
    chunks = _chunks(data)
    width, height = (int.from_bytes(chunks.get(b"IHDR", b"")[place : place + 4], "big") for place in (0, 4))
    if not 1 <= width * height <= MAX_PIXELS or b"IEND" not in chunks:
        raise unreadable(path, KIND)
    try:
        with quiet_decoders():
            pixels = imagecodecs.png_decode(data)
    except (RuntimeError, ValueError, TypeError, MemoryError, OverflowError):
        raise unreadable(path, KIND) from None
    orientation = orientation_of(chunks.get(b"eXIf", b""))
    return of_integers(pixels, KIND, lambda: _colours(path, chunks)).turned(orientation)


def exif(path: Path) -> bytes:
    """Its block of EXIF data; none where it has none."""
    return _chunks(path.read_bytes()).get(b"eXIf", b"")


def _chunks(data: bytes) -> dict[bytes, bytes]:
    """The first chunk of each kind, but for the pixels."""
    found: dict[bytes, bytes] = {}
    position = 8
    while position + 12 <= len(data):
        length = int.from_bytes(data[position : position + 4], "big")
        kind = data[position + 4 : position + 8]
        if kind != b"IDAT":
            found.setdefault(kind, data[position + 8 : position + 8 + length])
        position += 12 + length
    return found


def _colours(path: Path, chunks: dict[bytes, bytes]) -> Colours:
    """How values are encoded and what colours they are, by the chunks that have precedence [PNG3, 4.3]."""
    if coded := chunks.get(b"cICP"):
        if len(coded) != 4 or coded[0] not in _CODED_SPACES or coded[1] not in _CODED_TRANSFERS or coded[2:] != b"\0\1":
            raise ValueError(f"{path}: its cICP chunk ({coded[:4].hex(' ')}) names an encoding that is not read")
        return Colours(_CODED_TRANSFERS[coded[1]], _CODED_SPACES[coded[0]])
    if profile := chunks.get(b"iCCP"):
        compressed = profile[profile.find(b"\0") + 2 :]
        try:
            return colours_of_profile(path, zlib.decompressobj().decompress(compressed, _LARGEST_PROFILE))
        except zlib.error:
            raise ValueError(f"{path}: its colour profile (chunk iCCP) is damaged; export it again") from None
    if b"sRGB" in chunks:
        return Colours(SRGB, SPACES["rec709"])
    transfer = primaries = None
    if len(gamma := chunks.get(b"gAMA", b"")) == 4 and any(gamma):
        transfer = Transfer.power(1e5 / int.from_bytes(gamma, "big"))
    if len(chromaticities := chunks.get(b"cHRM", b"")) == 32:
        white_x, white_y, *colours = (np.frombuffer(chromaticities, ">u4") / 1e5).tolist()
        try:
            primaries = Primaries.of((*colours, white_x, white_y))
        except ValueError as error:
            raise ValueError(f"{path}: chunk cHRM: {error}") from None
    return Colours(transfer, primaries)
