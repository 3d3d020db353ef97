"""Pictures of 8 or 16 bits: decoding by OpenCV, and the orientation that EXIF data name."""

from pathlib import Path

import numpy as np

from torchbrdf.images.encodings import Transfer
from torchbrdf.images.formats._quiet import quiet_decoders
from torchbrdf.images.formats._stored import Stored, unreadable
from torchbrdf.images.primaries import Primaries


def decoded(path: Path, data: bytes, kind: str, transfer: Transfer | None, primaries: Primaries | None) -> Stored:
    """What a PNG or JPEG file holds, as it lies there; raises ValueError where it is damaged."""
    import cv2

    try:
        with quiet_decoders():
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        pixels = None
    if pixels is None or pixels.dtype.name not in ("uint8", "uint16"):
        raise unreadable(path, kind)
    if pixels.ndim == 3:
        pixels = pixels[..., [2, 1, 0, 3][: pixels.shape[2]]]
    return of_integers(pixels, kind, transfer, primaries)


def of_integers(pixels: np.ndarray, kind: str, transfer: Transfer | None, primaries: Primaries | None) -> Stored:
    """From (H, W) or (H, W, C) unsigned integers: grey or R, G, B, and perhaps alpha."""
    full_scale = int(np.iinfo(pixels.dtype).max)
    planes = np.atleast_3d(pixels).transpose(2, 0, 1).astype(np.float32) / np.float32(full_scale)
    count = 3 if len(planes) >= 3 else 1
    return Stored(
        np.ascontiguousarray(planes[:count]),
        f"{8 * pixels.dtype.itemsize}-bit {kind}",
        alpha=np.ascontiguousarray(planes[count]) if len(planes) > count else None,
        full_scale=full_scale,
        transfer=transfer,
        primaries=primaries,
    )


def orientation_of(exif: bytes) -> int:
    """The orientation, 1 to 8, that a block of EXIF data names; 1 where it names none."""
    from PIL import Image

    found = Image.Exif()
    try:
        found.load(exif)
        return int(found.get(0x0112, 1))
    except (OSError, ValueError, SyntaxError, LookupError, TypeError):
        return 1
