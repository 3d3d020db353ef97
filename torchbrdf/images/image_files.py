"""Linear HDR images in and out: OpenEXR, Radiance .hdr, and PNG for display.

Images are `(3, H, W)` float32 tensors of linear RGB, rows from the top. A written file is whole or
absent (`files.writing`).
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchbrdf.files import writing
from torchbrdf.images.display import DISPLAY_GAMMA, tone_map

_HDR_SUFFIXES = (".exr", ".hdr")
_IMAGE_SUFFIXES = (".exr", ".hdr", ".png")
_MASK_SUFFIXES = (".png", ".exr")
_BAD_FILE = " (truncated, damaged or another format)"
_EXR_ERRORS = (RuntimeError, ValueError, IndexError, KeyError, MemoryError)
_MAX_PIXELS = 2**28  # a header may ask for any size; 2**28 RGB pixels are 3 GB
_LONGEST_KEY = 31  # of an OpenEXR attribute that every reader accepts
_OWN_KEYS = (
    "channels", "chunkCount", "compression", "dataWindow", "displayWindow", "lineOrder", "maxSamplesPerPixel", "name",
    "pixelAspectRatio", "screenWindowCenter", "screenWindowWidth", "tiles", "type", "version", "view",
)  # fmt: skip


def read_image(path: str | os.PathLike[str], allow_ldr: bool = False) -> Tensor:
    """Read a linear RGB image.

    path       .exr (half, float or integer R, G, B in any order; alpha and other channels are ignored; the
               first part of a multi-part file; placed in its display window, black outside the data window),
               .hdr (Radiance RGBE), or .png
    allow_ldr  accept a PNG and decode it with gamma 2.2 to [0, 1]
    returns    (3, H, W) float32; not-a-number and infinite pixels are passed on
    raises     FileNotFoundError; ValueError when the file is not such an image
    """
    path = _existing(path, _IMAGE_SUFFIXES)
    suffix = path.suffix.lower()
    if suffix == ".png" and not allow_ldr:
        raise ValueError(f"{path}: 8-bit PNG is not linear HDR; give an .exr or .hdr image, "
                         "or pass --allow-ldr (allow_ldr=True in Python) to decode it with gamma 2.2")
    if suffix == ".exr":
        channels = _read_exr(path)
        if not {"R", "G", "B"} <= set(channels):
            raise ValueError(f"{path}: expected R, G, B channels, got {sorted(channels)}")
        pixels = np.stack([channels[name] for name in "RGB"])
    else:
        pixels = _read_opencv(path)
        if len(pixels) not in (3, 4):
            raise ValueError(f"{path}: expected R, G, B channels, got {len(pixels)} channel(s)")
        pixels = pixels[:3]
    image = torch.from_numpy(np.ascontiguousarray(pixels, dtype=np.float32))
    return image**DISPLAY_GAMMA if suffix == ".png" else image


def read_mask(path: str | os.PathLike[str]) -> Tensor:
    """Read a mask: True (use this pixel) where the mean of the colour channels is above one half.

    path       .png of any depth or .exr; grey, or colour (alpha is ignored)
    returns    (1, H, W) bool
    raises     FileNotFoundError; ValueError when the file is not such an image
    """
    path = _existing(path, _MASK_SUFFIXES)
    if path.suffix.lower() == ".exr":
        channels = _read_exr(path)
        if {"R", "G", "B"} <= set(channels):
            pixels = np.stack([channels[name] for name in "RGB"])
        elif len(channels) == 1:
            pixels = np.stack(list(channels.values()))
        else:
            raise ValueError(f"{path}: expected one channel or R, G, B for a mask, got {sorted(channels)}")
    else:
        pixels = _read_opencv(path)
        pixels = pixels[:3] if len(pixels) >= 3 else pixels[:1]
    return torch.from_numpy(pixels.mean(axis=0, keepdims=True) > 0.5)


def read_metadata(path: str | os.PathLike[str]) -> dict[str, str]:
    """The text attributes of an .exr file's first part, as `write_image` takes them; what OpenEXR itself needs is not.

    raises     FileNotFoundError; ValueError when the file is not an OpenEXR image
    """
    header = _exr_header(_existing(path, (".exr",)))
    return {key: value for key, value in header.items() if isinstance(value, str) and key not in _OWN_KEYS}


def write_image(path: str | os.PathLike[str], image: Tensor, metadata: Mapping[str, str] | None = None) -> None:
    """Write an image; the suffix chooses the format.

    path       .exr (float32, lossless), .hdr (RGBE: about 1 % precision, negatives become 0), or .png
               (8 bits, tone mapped by `tone_map`)
    image      (3, H, W) linear RGB; any device
    metadata   text to keep in the header, .exr only: `read_metadata` gives it back. Names of 1 to 31 characters,
               none of those that OpenEXR itself needs
    raises     ValueError for another shape or suffix, or metadata that the file cannot hold; OSError when the file
               cannot be written
    """
    path = Path(path)
    check_image_suffix(path)
    _check_image(image)
    suffix = path.suffix.lower()
    _check_metadata(metadata or {}, path)
    pixels = image.detach().to("cpu", torch.float32).numpy()
    with writing(path) as temporary:
        if suffix == ".exr":
            _write_exr(temporary, pixels, metadata or {})
        elif suffix == ".png":
            temporary.write_bytes(png_bytes(image))
        else:
            # OpenCV wraps negative mantissas round to bright pixels, and RGBE has no NaN or infinity.
            finite = np.nan_to_num(pixels, nan=0.0, posinf=1e37, neginf=0.0).clip(0.0, 1e37)
            temporary.write_bytes(_encode(".hdr", finite.transpose(1, 2, 0)))


def check_image_suffix(path: Path) -> None:
    """Raise ValueError where `write_image` knows no format of this suffix."""
    _check_suffix(path, _IMAGE_SUFFIXES)


def png_bytes(image: Tensor, exposure: float = 1.0) -> bytes:
    """The tone-mapped image as an 8-bit PNG file in memory.

    image      (3, H, W) linear RGB; any device
    """
    _check_image(image)
    display = (tone_map(image.detach().to("cpu", torch.float32), exposure) * 255).round().to(torch.uint8)
    return _encode(".png", display.permute(1, 2, 0).numpy())


def _check_suffix(path: Path, supported: tuple[str, ...]) -> None:
    if path.suffix.lower() not in supported:
        raise ValueError(f"{path}: image suffix {path.suffix!r} is not supported; use {', '.join(supported)}")


def _check_image(image: Tensor) -> None:
    if image.ndim != 3 or image.shape[0] != 3 or image.numel() == 0:
        raise ValueError(f"image must be (3, H, W), got {tuple(image.shape)}")


def _check_metadata(metadata: Mapping[str, str], path: Path) -> None:
    if metadata and path.suffix.lower() != ".exr":
        raise ValueError(f"{path}: only .exr files hold metadata; write an .exr, or leave the metadata out")
    for key, value in metadata.items():
        if not (isinstance(key, str) and isinstance(value, str)):
            raise ValueError(f"metadata must be text by name, got {key!r}: {value!r}")
        if key in _OWN_KEYS:
            raise ValueError(f"metadata must not be named {key!r}, which OpenEXR keeps for itself; choose another name")
        if not 1 <= len(key.encode()) <= _LONGEST_KEY or "\0" in key + value:
            raise ValueError(
                f"metadata needs names of 1 to {_LONGEST_KEY} characters and no zero bytes, got {key!r}: {value!r}"
            )


def _existing(path: str | os.PathLike[str], supported: tuple[str, ...]) -> Path:
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    _check_suffix(path, supported)
    if path.is_dir():
        raise ValueError(f"{path}: is a folder; expected an image file ({', '.join(supported)})")
    with path.open("rb"):  # no permission: the system's message names the file, the decoders' do not
        return path


@contextlib.contextmanager
def _quiet_decoders() -> Iterator[None]:
    """Drop what OpenEXR and OpenCV print about a bad file (from C, to descriptor 2): we raise one line."""
    sys.stderr.flush()
    saved = os.dup(2)
    try:
        with open(os.devnull, "w") as sink, contextlib.redirect_stdout(sink):
            os.dup2(sink.fileno(), 2)
            yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)


def _read_exr(path: Path) -> dict[str, np.ndarray]:
    """The channels of the first part, each (H, W) float32 over the display window."""
    import OpenEXR

    header = _exr_header(path)
    try:
        with _quiet_decoders():
            windows = (*header["dataWindow"], *header["displayWindow"])
            corners = [np.asarray(corner, dtype=np.int64) for corner in windows]
            data_min, data_max, view_min, view_max = corners
            data_size, view_size = data_max - data_min + 1, view_max - view_min + 1
            if min(*data_size, *view_size) < 1 or max(data_size.prod(), view_size.prod()) > _MAX_PIXELS:
                raise ValueError("size")
            with OpenEXR.File(str(path), separate_channels=True) as file:
                stored = {name: channel.pixels for name, channel in file.parts[0].channels.items()}
    except _EXR_ERRORS:
        raise ValueError(f"{path}: not a readable OpenEXR image{_BAD_FILE}") from None

    lo = np.maximum(data_min, view_min)
    hi = np.minimum(data_max, view_max) + 1
    channels = {}
    for name, pixels in stored.items():
        if pixels is None or pixels.shape != (data_size[1], data_size[0]):
            continue  # deep or subsampled channels hold no RGB image
        placed = np.zeros((view_size[1], view_size[0]), dtype=np.float32)
        if (lo < hi).all():
            (x0, y0), (x1, y1) = lo - view_min, hi - view_min
            (u0, v0), (u1, v1) = lo - data_min, hi - data_min
            placed[y0:y1, x0:x1] = pixels[v0:v1, u0:u1]
        channels[name] = placed
    return channels


def _exr_header(path: Path) -> dict[str, Any]:
    """The attributes of the first part."""
    import OpenEXR

    try:
        with _quiet_decoders(), OpenEXR.File(str(path), separate_channels=True, header_only=True) as file:
            return dict(file.parts[0].header)
    except _EXR_ERRORS:
        raise ValueError(f"{path}: not a readable OpenEXR image{_BAD_FILE}") from None


def _read_opencv(path: Path) -> np.ndarray:
    """Radiance .hdr as it is, or PNG over its full scale: (channels, H, W) float32, in order R, G, B, A."""
    import cv2

    kind = {".hdr": "Radiance .hdr", ".png": "PNG"}[path.suffix.lower()]
    try:
        with _quiet_decoders():
            pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        pixels = None
    expected = ("float32",) if path.suffix.lower() == ".hdr" else ("uint8", "uint16")
    if pixels is None or pixels.dtype.name not in expected:
        raise ValueError(f"{path}: not a readable {kind} image{_BAD_FILE}")
    scale = {"float32": 1, "uint8": 255, "uint16": 65535}[pixels.dtype.name]
    pixels = (pixels[..., None] if pixels.ndim == 2 else pixels).astype(np.float32) / np.float32(scale)
    if pixels.shape[2] >= 3:
        pixels = pixels[..., [2, 1, 0, *range(3, pixels.shape[2])]]
    return np.ascontiguousarray(pixels.transpose(2, 0, 1))


def _encode(suffix: str, pixels: np.ndarray) -> bytes:
    """A file's bytes from (H, W, 3) RGB."""
    import cv2

    done, encoded = cv2.imencode(suffix, np.ascontiguousarray(pixels[..., ::-1]))
    if not done:
        raise OSError(f"OpenCV could not encode a {suffix} image of {pixels.shape[0]} x {pixels.shape[1]}")
    return encoded.tobytes()


def _write_exr(path: Path, pixels: np.ndarray, metadata: Mapping[str, str]) -> None:
    import OpenEXR

    header = {**metadata, "compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    # OpenEXR 3.5 silently writes wrong pixels for a non-contiguous array.
    channels = {name: np.ascontiguousarray(plane) for name, plane in zip("RGB", pixels, strict=True)}
    try:
        with _quiet_decoders(), OpenEXR.File(header, channels) as file:
            file.write(str(path))
    except RuntimeError as error:
        raise OSError(str(error)) from None
