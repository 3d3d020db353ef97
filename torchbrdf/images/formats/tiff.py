"""TIFF: floating-point radiance, or integers, with what the file says of their colours [TIFF6]."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from torchbrdf.images.encodings import Transfer
from torchbrdf.images.formats._colour_profile import colours_of_profile
from torchbrdf.images.formats._integers import of_integers
from torchbrdf.images.formats._stored import MAX_PIXELS, Stored, unreadable
from torchbrdf.images.primaries import Primaries

if TYPE_CHECKING:
    from tifffile import TiffFile, TiffPage

SUFFIXES = (".tif", ".tiff")

_KIND = "TIFF"
_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB = 0, 1, 2
_ORIENTATION, _WHITE_POINT, _CHROMATICITIES, _PROFILE = 274, 318, 319, 34675


class _Refusal(Exception):
    """What is wrong with a sound file."""


def read(path: Path) -> Stored:
    """The picture of a file; raises ValueError for damage, several pictures, and pixels that are no grey or RGB."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            page = _only_page(file)
            _check_whole(page, path.stat().st_size)
            pixels = page.asarray()
            if page.axes == "SYX":
                pixels = pixels.transpose(1, 2, 0)
            colours = _colours(path, page)
            orientation = int(page.tags.valueof(_ORIENTATION, 1))
            return _stored(pixels, int(page.photometric), *colours).turned(orientation)
    except _Refusal as refusal:
        raise ValueError(f"{path}: {refusal}") from None
    except Exception as error:  # tifffile's decoders raise errors of many kinds
        if isinstance(error, ValueError) and str(error).startswith(f"{path}: "):
            raise
        raise unreadable(path, _KIND) from None


def _only_page(file: TiffFile) -> TiffPage:
    """The page of the picture; previews are marked as such."""
    import tifffile

    pages = [page for page in file.pages if not (isinstance(page, tifffile.TiffPage) and page.is_reduced)]
    if len(pages) > 1:
        raise _Refusal(f"holds {len(pages)} pictures; write the one that is meant to a file of its own")
    if not isinstance(pages[0], tifffile.TiffPage):
        raise ValueError
    return pages[0]


def _check_whole(page: TiffPage, size: int) -> None:
    """Raise where the file cannot hold its picture: tifffile fills in zeros."""
    import tifffile

    if page.axes not in ("YX", "YXS", "SYX"):
        raise _Refusal(f"has axes {page.axes}; expected rows and columns of grey or R, G, B")
    if int(page.photometric) not in (_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB):
        raise _Refusal(f"holds pixels of the kind {tifffile.PHOTOMETRIC(page.photometric).name}; write R, G, B")
    ends = [offset + count for offset, count in zip(page.dataoffsets, page.databytecounts, strict=True)]
    if not ends or max(ends) > size or min(page.databytecounts) < 1 or not 1 <= np.prod(page.shape[:2]) <= MAX_PIXELS:
        raise ValueError("truncated")
    if page.compression == 1 and page.nbytes > sum(page.databytecounts):
        raise ValueError("truncated")


def _colours(path: Path, page: TiffPage) -> tuple[Transfer | None, Primaries | None]:
    if profile := page.tags.valueof(_PROFILE):
        return colours_of_profile(path, bytes(profile))
    chromaticities, white = page.tags.valueof(_CHROMATICITIES), page.tags.valueof(_WHITE_POINT)
    if chromaticities is None or white is None:
        return None, None
    numbers = np.array((*chromaticities, *white), dtype=float).reshape(-1, 2)  # numerators and denominators
    return None, Primaries.of(tuple((numbers[:, 0] / numbers[:, 1]).tolist()))


def _stored(pixels: np.ndarray, photometric: int, transfer: Transfer | None, primaries: Primaries | None) -> Stored:
    if pixels.dtype.kind == "u" and pixels.dtype.itemsize <= 2:
        if photometric == _WHITE_IS_ZERO:
            pixels = np.iinfo(pixels.dtype).max - pixels
        return of_integers(pixels, _KIND, transfer, primaries)
    if pixels.dtype.kind != "f" or photometric == _WHITE_IS_ZERO:
        raise _Refusal(f"holds {pixels.dtype} values; write 32-bit floating-point ones, or 16-bit unsigned integers")
    planes = np.atleast_3d(pixels).transpose(2, 0, 1).astype(np.float32)
    count = 3 if len(planes) >= 3 else 1
    alpha = planes[count] if len(planes) > count else None
    return Stored(planes[:count], "floating-point TIFF", alpha=alpha, transfer=transfer, primaries=primaries)
