"""TIFF: floating-point radiance, or integers, with what the file says of their colours [TIFF6]."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from torchbrdf.images.formats._colour_profile import colours_of_profile
from torchbrdf.images.formats._integers import of_integers
from torchbrdf.images.formats._quiet import quiet_decoders
from torchbrdf.images.formats._stored import MAX_PIXELS, Colours, Stored, unreadable
from torchbrdf.images.primaries import Primaries

if TYPE_CHECKING:
    from tifffile import TiffFile, TiffPage

KIND = "TIFF"
SUFFIXES = (".tif", ".tiff")
SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")

_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB = 0, 1, 2
_ORIENTATION, _WHITE_POINT, _CHROMATICITIES, _EXTRA_SAMPLES, _PROFILE = 274, 318, 319, 338, 34675
_IS_ALPHA = (1, 2)
_MOST_PAGES = 100
"""More are not counted: pages of a damaged file may follow one another in a circle."""
_MOST_A_BYTE = {1: 1, 32773: 64, 5: 1400, 8: 1040, 32946: 1040}
"""Bytes of pixels that one byte can stand for: as they are, PackBits, LZW (a table full of one run) and Deflate."""


class _Refusal(Exception):
    """What is wrong with a sound file."""


def read(path: Path) -> Stored:
    """The picture of a file; raises ValueError for damage, several pictures, and pixels that are no grey or RGB."""
    import tifffile

    try:
        with quiet_decoders(), tifffile.TiffFile(path) as file:
            page = _only_page(file)
            _check_whole(page, path.stat().st_size)
            _check_page(page)
            pixels = page.asarray()
            tags = {code: page.tags.valueof(code) for code in (_WHITE_POINT, _CHROMATICITIES, _PROFILE)}
            extra = page.tags.valueof(_EXTRA_SAMPLES)
            orientation = page.tags.valueof(_ORIENTATION, 1)
        if page.axes == "SYX":
            pixels = pixels.transpose(1, 2, 0)
        stored = _stored(pixels, page, path, tags)
        return _named_alpha(stored, extra).turned(orientation)
    except _Refusal as refusal:
        raise ValueError(f"{path}: {refusal}") from None
    except Exception:  # tifffile's decoders raise errors of many kinds
        raise unreadable(path, KIND) from None


def _only_page(file: TiffFile) -> TiffPage:
    """The page of the picture; previews are marked as such."""
    import tifffile

    every = [page for page in islice(file.pages, _MOST_PAGES) if isinstance(page, tifffile.TiffPage)]
    pages = [page for page in every if not page.is_reduced]
    if every and not pages:
        raise _Refusal("holds previews alone, as cameras' raw files do; develop it to a linear .exr or .tif")
    if len(pages) > 1:
        count = f"{len(pages)} or more" if len(every) == _MOST_PAGES else len(pages)
        raise _Refusal(f"holds {count} pictures; write the one that is meant to a file of its own")
    return pages[0]


def _check_page(page: TiffPage) -> None:
    import tifffile

    try:
        tifffile.TIFF.DECOMPRESSORS[page.compression]
    except KeyError:
        name = getattr(page.compression, "name", page.compression)
        raise _Refusal(f"is compressed in a way that is not read ({name}); save it with LZW or Deflate") from None
    if page.axes not in ("YX", "YXS", "SYX"):
        raise _Refusal(f"has axes {page.axes}; expected rows and columns of grey or R, G, B")
    kind = int(page.photometric)
    if kind not in (_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB):
        raise _Refusal(f"holds pixels of the kind {tifffile.PHOTOMETRIC(kind).name}; write R, G, B")
    if page.dtype is None or page.dtype.kind not in "buf" or (page.dtype.kind == "u" and page.dtype.itemsize > 2):
        raise _Refusal(f"holds {page.dtype} values; write 32-bit floating-point ones, or 16-bit unsigned integers")
    if page.dtype.kind == "f" and kind == _WHITE_IS_ZERO:
        raise _Refusal("holds floating-point values with 0 for white; write 0 for black")


def _check_whole(page: TiffPage, size: int) -> None:
    """Raise where the file cannot hold its picture: tifffile fills in zeros."""
    counts = page.databytecounts
    ends = [offset + count for offset, count in zip(page.dataoffsets, counts, strict=True)]
    whole = len(ends) >= np.prod(page.chunked) and min(counts) > 0 and max(ends) <= size
    if not whole or not 1 <= page.imagewidth * page.imagelength <= MAX_PIXELS:
        raise ValueError("truncated")
    most = _MOST_A_BYTE.get(int(page.compression))
    if most is not None and page.size * np.mean(page.bitspersample) > 8 * most * size:
        raise ValueError("truncated")


def _stored(pixels: np.ndarray, page: TiffPage, path: Path, tags: dict[int, Any]) -> Stored:
    """Values of (H, W) or (H, W, C), what is beside grey or R, G, B as alpha."""

    def colours() -> Colours:
        return _colours(path, tags)

    if pixels.dtype.kind == "f":
        planes = np.atleast_3d(pixels).transpose(2, 0, 1).astype(np.float32)
        count = 3 if len(planes) >= 3 else 1
        alpha = planes[count] if len(planes) > count else None
        return Stored(planes[:count], f"floating-point {KIND}", alpha=alpha, colours=colours)
    bits = int(page.bitspersample)
    pixels = pixels.astype(np.uint8) if pixels.dtype.kind == "b" else pixels
    if int(page.photometric) == _WHITE_IS_ZERO:
        pixels = (1 << bits) - 1 - pixels
    return of_integers(pixels, KIND, colours, bits)


def _named_alpha(stored: Stored, extra: tuple[int, ...] | None) -> Stored:
    """A channel beside the colours that the file does not call alpha is alpha where it can be, and this is said."""
    alpha = stored.telling_alpha
    if alpha is None or (extra and extra[0] in _IS_ALPHA):
        return stored
    if not (alpha.min() >= 0 and alpha.max() <= 1):
        return replace(stored, alpha=None)
    return replace(stored, about="a channel beside its colours, which it does not name, taken as alpha")


def _colours(path: Path, tags: dict[int, Any]) -> Colours:
    if profile := tags[_PROFILE]:
        if not isinstance(profile, bytes):
            raise unreadable(path, KIND, "its colour profile is damaged")
        return colours_of_profile(path, profile)
    chromaticities, white = tags[_CHROMATICITIES], tags[_WHITE_POINT]
    if chromaticities is None or white is None:
        return Colours()
    numbers = np.array((*chromaticities, *white), dtype=float).reshape(-1, 2)  # numerators and denominators
    try:
        with np.errstate(all="ignore"):
            return Colours(primaries=Primaries.of(tuple((numbers[:, 0] / numbers[:, 1]).tolist())))
    except ValueError as error:
        raise ValueError(f"{path}: PrimaryChromaticities and WhitePoint: {error}") from None
