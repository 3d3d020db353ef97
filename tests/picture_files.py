"""Files of pictures, written for tests by other means than the package's."""

import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import OpenEXR
import torch


def picture(height: int = 9, width: int = 14, seed: int = 0) -> torch.Tensor:
    return torch.rand(3, height, width, generator=torch.Generator().manual_seed(seed)) * 100


def write_exr(path: Path, channels: Mapping[str, np.ndarray], **header: object) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    with OpenEXR.File(header, {name: np.ascontiguousarray(plane) for name, plane in channels.items()}) as file:
        file.write(str(path))


def write_exr_parts(path: Path, parts: Mapping[str, Mapping[str, np.ndarray]]) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File([OpenEXR.Part(dict(header), dict(planes), name) for name, planes in parts.items()]) as file:
        file.write(str(path))


def window(x0: int, y0: int, x1: int, y1: int) -> tuple[np.ndarray, np.ndarray]:
    return np.array([x0, y0], "i4"), np.array([x1, y1], "i4")


def rgb(values: np.ndarray, prefix: str = "", names: Sequence[str] = "RGB") -> dict[str, np.ndarray]:
    """Channels of (3, H, W)."""
    return {prefix + name: np.ascontiguousarray(plane) for name, plane in zip(names, values, strict=True)}


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(rows: Sequence[bytes], width: int, depth: int = 8, kind: int = 2, chunks: bytes = b"") -> bytes:
    """A PNG file of unfiltered rows."""
    header = struct.pack(">IIBBBBB", width, len(rows), depth, kind, 0, 0, 0)
    pixels = zlib.compress(b"".join(b"\0" + row for row in rows))
    signature = b"\x89PNG\r\n\x1a\n"
    return signature + chunk(b"IHDR", header) + chunks + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def png_of(pixels: np.ndarray, chunks: bytes = b"") -> bytes:
    """A PNG file of (H, W), (H, W, 2), (H, W, 3) or (H, W, 4), 8 or 16 bits: grey or R, G, B, and alpha."""
    pixels = pixels.reshape(*pixels.shape[:2], -1)
    kind = {1: 0, 2: 4, 3: 2, 4: 6}[pixels.shape[2]]
    depth = 8 * pixels.dtype.itemsize
    rows = [row.astype(pixels.dtype.newbyteorder(">")).tobytes() for row in pixels]
    return png(rows, pixels.shape[1], depth, kind, chunks)


def exif(orientation: int) -> bytes:
    """A block of EXIF data that names the orientation alone."""
    return b"MM\0*\0\0\0\x08" + struct.pack(">HHHIHHI", 1, 0x0112, 3, 1, orientation, 0, 0)


def as_orientation(upright: np.ndarray, orientation: int) -> np.ndarray:
    """(H, W, ...) as a camera that is held so stores it: the inverse of what a viewer does."""
    return {
        1: lambda p: p,
        2: lambda p: p[:, ::-1],
        3: lambda p: p[::-1, ::-1],
        4: lambda p: p[::-1],
        5: lambda p: p.swapaxes(0, 1),
        6: lambda p: np.rot90(p),  # to be turned clockwise by 90 degrees
        7: lambda p: p[::-1, ::-1].swapaxes(0, 1),
        8: lambda p: np.rot90(p, -1),
    }[orientation](upright)


def disc(height: int = 40, width: int = 50, row: float = 19, column: float = 22, radius: float = 12) -> np.ndarray:
    """(H, W) bool."""
    rows, columns = np.mgrid[:height, :width]
    return (rows - row) ** 2 + (columns - column) ** 2 < radius**2
