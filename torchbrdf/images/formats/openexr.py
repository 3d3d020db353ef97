"""OpenEXR: one RGB picture among the parts, layers and channels of a file, placed in its display window [EXR]."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from torchbrdf.files import printable
from torchbrdf.images.formats._quiet import quiet_decoders
from torchbrdf.images.formats._space_names import space_named
from torchbrdf.images.formats._stored import MAX_PIXELS, Colours, Stored, Window, check_pixel_aspect, unreadable
from torchbrdf.images.primaries import Primaries

KIND = "OpenEXR"
SUFFIXES = (".exr",)
SIGNATURES = (b"\x76\x2f\x31\x01",)

_ERRORS = (RuntimeError, ValueError, LookupError, TypeError, ArithmeticError, MemoryError)
"""What the library raises for damaged files."""

_MOST_PIXELS_A_BYTE = {"NO": 4, "RLE": 64, "ZIPS": 1040, "ZIP": 1040, "PIZ": 400, "PXR24": 1040, "B44": 16, "B44A": 16}
"""By compression; black pictures of one channel come to half of that."""
_MOST_OF_OTHERS = 1 << 13
"""Of black pictures in DWAB 3700, in HTJ2K256 3500."""
_SMALL, _LARGE = 1 << 20, 1 << 25
_SHOWN_A_BYTE = 1024
_LARGEST_TILE = 1 << 22
"""Tiles may be that large, or else four times the picture: a power of two has room for it."""
_SHOWN_A_RECORDED = 64
"""A display window beyond `_SMALL` pixels has so many for a byte of the file, beyond `_LARGE` for a recorded pixel."""

_CASES = (str.lower, str.title, str.upper)
_COLOURS = (("R", "G", "B"), ("r", "g", "b"), *((case("red"), case("green"), case("blue")) for case in _CASES))
_VECTORS = (("X", "Y", "Z"), ("x", "y", "z"))
"""How programs name channels that belong together."""
_ALPHAS = ("A", "a", *(case("alpha") for case in _CASES))


@dataclass(frozen=True)
class _Layer:
    """Channels of one part that belong together.

    label     what `--layer` calls it
    part      of the file
    channels  in the order R, G, B (or X, Y, Z, or one that is grey)
    alpha     the name of its alpha, or None
    """

    label: str
    part: int
    channels: tuple[str, ...]
    alpha: str | None = None

    @property
    def plain(self) -> bool:
        """Whether its channels stand under the names that every reader looks for."""
        return self.channels in (_COLOURS[0], _VECTORS[0])


def read(path: Path, layer: str | None = None, vectors: bool = False, option: str = "") -> Stored:
    """One picture of a file; raises ValueError where there is none, or there are several and none is chosen.

    layer    its label, as messages list them
    vectors  prefer channels X, Y, Z
    option   what names a layer on the command line; empty where nothing does
    """
    headers = read_headers(path)
    chosen = _chosen(path, headers, layer, vectors, option)
    header = headers[chosen.part]
    names = [*chosen.channels, *([chosen.alpha] if chosen.alpha else [])]
    for other in headers:
        _check_room(path, other)  # all are decoded
    window, size = _windows(path, header)
    check_pixel_aspect(path, float(header.get("pixelAspectRatio", 1)))
    planes = _planes(path, chosen.part, names, (window.height, window.width))
    placed, recorded = _placed(path, planes, window, size)
    count = len(chosen.channels)
    alpha = np.nan_to_num(placed[count], nan=0.0) if chosen.alpha else None
    return Stored(
        placed[:count],
        KIND,
        alpha=alpha,
        colours=lambda: _colours(path, header),
        window=recorded,
        about="" if chosen.part == 0 and (chosen.plain or count == 1) else f"layer {printable(chosen.label)}",
    )


def read_headers(path: Path) -> list[dict[str, Any]]:
    """The attributes of every part; of its channels the names."""
    import OpenEXR

    try:
        with quiet_decoders(), OpenEXR.File(os.fsencode(path), separate_channels=True, header_only=True) as file:
            headers = [dict(part.header) for part in file.parts]
            return [
                {**header, "channels": [channel.name for channel in header.get("channels", ())]} for header in headers
            ]
    except _ERRORS:
        raise unreadable(path, KIND) from None


def _chosen(
    path: Path, headers: Sequence[Mapping[str, Any]], label: str | None, vectors: bool, option: str
) -> _Layer:
    flat = [i for i, header in enumerate(headers) if "deep" not in str(header.get("type"))]
    if not flat:
        raise ValueError(f"{path}: is a deep image, many samples in each pixel; flatten it where it was made")
    colours, fields = ([one for i in flat for one in _layers(i, headers, names)] for names in (_COLOURS, _VECTORS))
    if label is not None:
        return _named(path, [*(fields if vectors else ()), *colours], label)
    found = fields if vectors and fields else colours
    if len(found) == 1:
        return found[0]
    plain = [one for one in found if one.plain]
    if len(plain) == 1 and plain[0].part == flat[0]:
        return plain[0]
    if found:
        cure = f"choose one: {option} NAME" if option else "write the one that is meant alone, or choose it"
        raise ValueError(f"{path}: holds several pictures; {cure} (layer= in Python) of {_listed(found)}")
    names = sorted(name for i in flat for name in headers[i]["channels"])
    greys = [name for name in names if name != "A"] or names
    if len(flat) == len(greys) == 1:
        return _Layer(greys[0], flat[0], tuple(greys), "A" if len(names) > 1 else None)
    if {"Y", "RY", "BY"} <= set(names):
        raise ValueError(f"{path}: is a luminance/chroma image (Y, RY, BY); write it as R, G, B")
    what = "; X, Y, Z may be vectors or CIE XYZ: write R, G, B" if fields else ""
    raise ValueError(f"{path}: expected R, G, B channels, got {names}{what}")


def _named(path: Path, layers: Sequence[_Layer], label: str) -> _Layer:
    """The layer of this label, in these letters or else in capitals or small ones."""
    for written in (str, str.casefold):
        for layer in layers:
            if written(layer.label) == written(label):
                return layer
    raise ValueError(f"{path}: has no layer {label!r}; it has {_listed(layers) or 'none with R, G, B'}")


def _listed(layers: Sequence[_Layer]) -> str:
    return printable(", ".join(one.label for one in layers))


def _layers(part: int, headers: Sequence[Mapping[str, Any]], wanted: Sequence[tuple[str, ...]]) -> list[_Layer]:
    """All sets of channels that are named so, in one part, with a prefix or without."""
    names = headers[part]["channels"]
    prefixes = dict.fromkeys(name[: name.rfind(".") + 1] for name in names)
    of_part = str(headers[part].get("name", part)) if len(headers) > 1 else ""
    found = []
    for prefix in prefixes:
        alpha = next((prefix + name for name in _ALPHAS if prefix + name in names), None)
        sets = [channels for channels in wanted if all(prefix + name in names for name in channels)]
        for channels in sets:
            own = "".join(channels) if len(sets) > 1 or not (of_part or prefix) else ""
            label = ".".join(filter(None, (of_part, prefix[:-1], own)))
            found.append(_Layer(label, part, tuple(prefix + name for name in channels), alpha))
    return found


def _corners(path: Path, header: Mapping[str, Any]) -> list[np.ndarray]:
    """The first and the last pixel of the data window and of the display window, x and y."""
    try:
        return [np.asarray(corner, dtype=np.int64) for corner in (*header["dataWindow"], *header["displayWindow"])]
    except _ERRORS:
        raise unreadable(path, KIND) from None


def _check_room(path: Path, header: Mapping[str, Any]) -> None:
    """Raise where a part asks for more memory than the file can fill."""
    data_min, data_max, view_min, view_max = _corners(path, header)
    data_size, view_size = data_max - data_min + 1, view_max - view_min + 1
    recorded, shown, size = data_size.prod(), view_size.prod(), path.stat().st_size
    compression = getattr(header.get("compression"), "name", "").removesuffix("_COMPRESSION")
    if (
        min(*data_size, *view_size) < 1
        or max(recorded, shown) > MAX_PIXELS
        or recorded > _MOST_PIXELS_A_BYTE.get(compression, _MOST_OF_OTHERS) * size
        or shown > max(_SMALL, min(_LARGE, _SHOWN_A_BYTE * size), _SHOWN_A_RECORDED * recorded)
    ):
        sizes = " and ".join(f"{width} x {height}" for width, height in (data_size, view_size))
        raise unreadable(path, KIND, f"its windows claim {sizes} pixels")
    tiles = header.get("tiles")
    if tiles is not None and tiles.xSize * tiles.ySize > max(_LARGEST_TILE, 4 * recorded):
        raise unreadable(path, KIND, f"its tiles claim {tiles.xSize} x {tiles.ySize} pixels")


def _windows(path: Path, header: Mapping[str, Any]) -> tuple[Window, tuple[int, int]]:
    """The data window, in the coordinates of the display window, and (height, width) of that."""
    data_min, data_max, view_min, view_max = _corners(path, header)
    data_size, view_size = data_max - data_min + 1, view_max - view_min + 1
    left, top = (data_min - view_min).tolist()
    return Window(left, top, int(data_size[0]), int(data_size[1])), (int(view_size[1]), int(view_size[0]))


def _planes(path: Path, part: int, names: Sequence[str], size: tuple[int, int]) -> list[np.ndarray]:
    """Channels of one part as they are stored, each of the size of the data window."""
    import OpenEXR

    try:
        with quiet_decoders(), OpenEXR.File(os.fsencode(path), separate_channels=True) as file:
            channels = [file.parts[part].channels[name] for name in names]
            planes = [channel.pixels for channel in channels]
    except _ERRORS:
        raise unreadable(path, KIND) from None
    for channel in channels:
        if (channel.xSampling, channel.ySampling) != (1, 1):
            name = printable(channel.name)
            raise ValueError(f"{path}: its channel {name} is subsampled; write all channels at full size")
    if any(plane is None or plane.shape != size for plane in planes):
        raise unreadable(path, KIND)
    return planes


def _placed(
    path: Path, planes: Sequence[np.ndarray], window: Window, size: tuple[int, int]
) -> tuple[np.ndarray, Window | None]:
    """(C, H, W) float32 over the display window, and the part of it that was recorded, None for all."""
    height, width = size
    top, left = max(window.top, 0), max(window.left, 0)
    bottom, right = min(window.top + window.height, height), min(window.left + window.width, width)
    if top >= bottom or left >= right:
        raise ValueError(f"{path}: recorded nothing of its display window; crop or move it where it was made")
    recorded = Window(left, top, right - left, bottom - top)
    placed = np.full((len(planes), height, width), np.nan, dtype=np.float32)
    rows, columns = slice(top - window.top, bottom - window.top), slice(left - window.left, right - window.left)
    for target, plane in zip(placed, planes, strict=True):
        target[recorded.slices] = plane[rows, columns]
    return placed, recorded if (recorded.width, recorded.height) != (width, height) else None


def _colours(path: Path, header: Mapping[str, Any]) -> Colours:
    if "chromaticities" not in header:
        return Colours(primaries=space_named(path, header))
    try:
        return Colours(primaries=Primaries.of(tuple(float(number) for number in header["chromaticities"])))
    except (TypeError, ValueError) as error:
        raise ValueError(f"{path}: chromaticities: {error}") from None
