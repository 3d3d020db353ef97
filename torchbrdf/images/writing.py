"""Linear HDR pictures to files: OpenEXR, Radiance .hdr, PNG and JPEG for display; whole or absent (`files.writing`)."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import get_args

import numpy as np
import torch
from torch import Tensor

from torchbrdf.files import writing
from torchbrdf.images.display import tone_map
from torchbrdf.images.formats import quiet_decoders
from torchbrdf.images.pictures import OWN_KEYS
from torchbrdf.images.primaries import converted, space_named
from torchbrdf.images.settings import DEFAULT_SPACE, ColourSpace, EnvironmentMap

DISPLAY_SUFFIXES = (".png", ".jpg", ".jpeg")
"""Of files for eyes, whose pixels are tone mapped."""

_SUFFIXES = (".exr", ".hdr", *DISPLAY_SUFFIXES)
_PNG_COMPRESSION = 4
"""Of zlib: a report is a quarter smaller than with OpenCV's 1, and the 30 pictures take 20 ms more."""

_LEAST_EXPONENT = -110
"""Of pixels in .hdr files: what OpenCV takes for black, and far from where float32 ends."""

LONGEST_KEY = 31
"""Of an OpenEXR attribute that every reader accepts, in bytes."""


def write_image(
    path: str | os.PathLike[str],
    image: Tensor,
    metadata: Mapping[str, str | float] | None = None,
    *,
    primaries: ColourSpace = DEFAULT_SPACE,
    alpha: Tensor | None = None,
    envmap: EnvironmentMap | None = None,
) -> None:
    """Write an image; the suffix chooses the format.

    path       .exr (float32, lossless), .hdr (RGBE: to 0.4 % of a pixel's brightest channel, negatives become 0), or
               .png or .jpg (8 bits, tone mapped by `tone_map`)
    image      (3, H, W) linear RGB; any device. In .exr files NaN marks pixels that were not recorded, and
               infinity those that were too bright
    metadata   text and numbers (whole ones of 32 bits) to keep in the header, .exr only: `read_metadata` gives the text
               back. Names of 1 to 31 characters, none of those that OpenEXR itself needs
    primaries  the colour space of the image, which .exr and .hdr files then name; for display it is converted to
               Rec. 709
    alpha      (1, H, W) in [0, 1], .exr only
    envmap     says how light from all directions is laid out, .exr only
    raises     ValueError for another shape, suffix or colour space, or metadata, alpha or envmap that the file cannot
               hold; OSError when the file cannot be written
    """
    path = Path(path)
    check_image_suffix(path)
    _check_image(image)
    suffix = path.suffix.lower()
    _check_metadata(metadata or {}, path)
    _check_beside(alpha, envmap, image, path)
    pixels = image.detach().to("cpu", torch.float32).numpy()
    with writing(path) as temporary:
        if suffix == ".exr":
            header = {**(metadata or {}), **_named_colours(primaries)}
            _write_exr(temporary, pixels, header, alpha, envmap)
        elif suffix in DISPLAY_SUFFIXES:
            temporary.write_bytes(_display_bytes(suffix, converted(image, primaries, DEFAULT_SPACE)))
        else:
            # OpenCV wraps negative mantissas round to bright pixels, and RGBE has no NaN or infinity.
            finite = np.nan_to_num(pixels, nan=0.0, posinf=1e37, neginf=0.0).clip(0.0, 1e37)
            encoded = _encode(".hdr", _nearest_rgbe(finite).transpose(1, 2, 0))
            for numbers in _named_colours(primaries).values():
                line = "PRIMARIES=" + " ".join(f"{number:g}" for number in numbers)
                encoded = encoded.replace(b"\n", f"\n{line}\n".encode(), 1)
            temporary.write_bytes(encoded)


def _named_colours(primaries: ColourSpace) -> dict[str, tuple[float, ...]]:
    """The attribute of an .exr file that names a colour space; none for the one that readers assume."""
    space = space_named(primaries)
    if primaries == DEFAULT_SPACE:
        return {}
    return {"chromaticities": tuple(number for point in space.values for number in point)}


def check_image_suffix(path: Path) -> None:
    """Raise ValueError where `write_image` knows no format of this suffix."""
    if path.suffix.lower() not in _SUFFIXES:
        raise ValueError(f"{path}: image suffix {path.suffix!r} is not supported; use {', '.join(_SUFFIXES)}")


def png_bytes(image: Tensor, exposure: float = 1.0) -> bytes:
    """The tone-mapped image as an 8-bit PNG file in memory.

    image      (3, H, W) linear RGB; any device
    """
    _check_image(image)
    return _display_bytes(".png", image, exposure)


def _display_bytes(suffix: str, image: Tensor, exposure: float = 1.0) -> bytes:
    display = (tone_map(image.detach().to("cpu", torch.float32), exposure) * 255).round().to(torch.uint8)
    return _encode(suffix, display.permute(1, 2, 0).numpy())


def _check_image(image: Tensor) -> None:
    if image.ndim != 3 or image.shape[0] != 3 or image.numel() == 0:
        raise ValueError(f"image must be (3, H, W), got {tuple(image.shape)}")


def _check_metadata(metadata: Mapping[str, str | float], path: Path) -> None:
    if metadata and path.suffix.lower() != ".exr":
        raise ValueError(f"{path}: only .exr files hold metadata; write an .exr, or leave the metadata out")
    for key, value in metadata.items():
        if not (isinstance(key, str) and isinstance(value, str | float | int)):
            raise ValueError(f"metadata must be text or numbers by name, got {key!r}: {value!r}")
        if isinstance(value, int) and not -(2**31) <= value < 2**31:  # OpenEXR would write another without a word
            raise ValueError(f"metadata holds whole numbers of 32 bits, got {key!r}: {value!r}; give it as text")
        if key in OWN_KEYS:
            raise ValueError(f"metadata must not be named {key!r}, which OpenEXR keeps for itself; choose another name")
        if not 1 <= len(key.encode()) <= LONGEST_KEY or "\0" in f"{key}{value}":
            raise ValueError(
                f"metadata needs names of 1 to {LONGEST_KEY} characters and no zero bytes, got {key!r}: {value!r}"
            )


def _check_beside(alpha: Tensor | None, envmap: EnvironmentMap | None, image: Tensor, path: Path) -> None:
    if (alpha is not None or envmap is not None) and path.suffix.lower() != ".exr":
        raise ValueError(f"{path}: only .exr files hold alpha and envmap; write an .exr, or leave them out")
    if alpha is not None and alpha.shape != (1, *image.shape[1:]):
        raise ValueError(f"alpha must be {(1, *image.shape[1:])}, as the image is, got {tuple(alpha.shape)}")
    if envmap not in (None, *get_args(EnvironmentMap)):
        raise ValueError(f"envmap must be one of {', '.join(get_args(EnvironmentMap))}, got {envmap!r}")


def _encode(suffix: str, pixels: np.ndarray) -> bytes:
    """A file's bytes from (H, W, 3) RGB."""
    import cv2

    settings = [cv2.IMWRITE_PNG_COMPRESSION, _PNG_COMPRESSION] if suffix == ".png" else []
    done, encoded = cv2.imencode(suffix, np.ascontiguousarray(pixels[..., ::-1]), settings)
    if not done:
        raise OSError(f"OpenCV could not encode a {suffix} image of {pixels.shape[0]} x {pixels.shape[1]}")
    return encoded.tobytes()


def _nearest_rgbe(pixels: np.ndarray) -> np.ndarray:
    """(3, H, W): the nearest numbers that RGBE holds, m 2^e with an exponent e a pixel and m in 0 to 255.

    OpenCV cuts mantissas off, by which pixels would become half a step darker.
    """
    brightest = pixels.max(axis=0)
    exponent = np.frexp(brightest)[1].clip(_LEAST_EXPONENT) - 8
    exponent += np.rint(np.ldexp(brightest, -exponent)) > 255
    return np.ldexp(np.rint(np.ldexp(pixels, -exponent)), exponent)


def _write_exr(
    path: Path,
    pixels: np.ndarray,
    metadata: Mapping[str, object],
    alpha: Tensor | None,
    envmap: EnvironmentMap | None,
) -> None:
    import OpenEXR

    header = {**metadata, "compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    if envmap is not None:
        header["envmap"] = {"latlong": OpenEXR.ENVMAP_LATLONG, "cube": OpenEXR.ENVMAP_CUBE}[envmap]
    # OpenEXR 3.5 silently writes wrong pixels for a non-contiguous array.
    channels = {name: np.ascontiguousarray(plane) for name, plane in zip("RGB", pixels, strict=True)}
    if alpha is not None:
        channels["A"] = np.ascontiguousarray(alpha.detach().to("cpu", torch.float32)[0].numpy())
    try:
        with quiet_decoders(), OpenEXR.File(header, channels) as file:
            file.write(os.fsencode(path))
    except RuntimeError as error:
        raise OSError(str(error)) from None
