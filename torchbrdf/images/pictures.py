"""Linear HDR pictures from files, in one colour space, with what the file says of itself."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
import torch
from torch import Tensor

from torchbrdf.files import existing_file
from torchbrdf.images.encodings import DECODERS, LINEAR, Transfer
from torchbrdf.images.formats import Stored, Window, read_headers, read_stored
from torchbrdf.images.primaries import SPACES, Primaries, conversion, space_named
from torchbrdf.images.settings import DEFAULT_SPACE, ColourSpace, Encoding, EnvironmentMap

OWN_KEYS = (
    "channels", "chunkCount", "compression", "dataWindow", "displayWindow", "lineOrder", "maxSamplesPerPixel", "name",
    "pixelAspectRatio", "screenWindowCenter", "screenWindowWidth", "tiles", "type", "version", "view",
)  # fmt: skip
"""Attributes that OpenEXR itself needs."""

_UNSAID = DECODERS["gamma2.2"]
"""Of integers whose file does not tell how they are encoded; a JPEG does, by convention."""


@dataclass(frozen=True)
class Picture:
    """A picture, and what its file says of it.

    image   (3, H, W) float32  linear RGB, rows from the top; NaN where the file recorded nothing
    alpha   (1, H, W) float32  in [0, 1]; None where the file has none, or one that is the same everywhere
    window  the part that was recorded; None for all of it
    full    (1, H, W) bool  a whole number is the largest that the file can hold; None where there are none
    about   how the file was read where it could be read otherwise, for people: phrases
    """

    image: Tensor
    alpha: Tensor | None = None
    window: Window | None = None
    full: Tensor | None = None
    about: tuple[str, ...] = ()


def read_image(
    path: str | os.PathLike[str],
    allow_ldr: bool = False,
    *,
    layer: str | None = None,
    primaries: ColourSpace = DEFAULT_SPACE,
    encoding: Encoding | None = None,
) -> Tensor:
    """Read a linear RGB image.

    path       .exr, .hdr or .pic (Radiance), .tif, .pfm, .npy: floating-point radiance. .png, .jpg and .tif of 8 or
               16 bits are taken only where that is allowed
    allow_ldr  decode integers, to [0, 1], as the file says (its profile, sRGB, gAMA), else with sRGB (JPEG)
               or gamma 2.2
    layer      which of several pictures of an .exr file, by the name that the message lists
    primaries  the colour space of the result, to which the file's is converted (whites adapted by Bradford's
               transform). A file that names none is taken as Rec. 709
    encoding   how integers are decoded, whatever the file says; implies allow_ldr
    returns    (3, H, W) float32. Not-a-number and infinite pixels are passed on, and pixels of the display window that
               an .exr file did not record are NaN
    raises     FileNotFoundError; ValueError when the file is not such an image
    """
    return read_picture(path, allow_ldr, layer=layer, primaries=primaries, encoding=encoding).image


def read_picture(
    path: str | os.PathLike[str],
    allow_ldr: bool | None = False,
    *,
    layer: str | None = None,
    primaries: ColourSpace = DEFAULT_SPACE,
    encoding: Encoding | None = None,
    layer_option: str = "--layer",
) -> Picture:
    """The same with all that the file says.

    allow_ldr     None where integers cannot be allowed at all
    layer_option  what names a layer on the command line
    """
    path = Path(path)
    stored = read_stored(path, layer, option=layer_option)
    if len(stored.values) != 3:
        raise ValueError(f"{path}: expected R, G, B channels, got one of grey")
    transfer, space = stored.colours()
    values, decoded = _linear(path, stored, transfer, allow_ldr, encoding)
    values, converted = _converted(values, space or SPACES[DEFAULT_SPACE], primaries)
    alpha = stored.telling_alpha
    return Picture(
        torch.from_numpy(values),
        None if alpha is None else torch.from_numpy(alpha[None]),
        stored.window,
        torch.from_numpy((stored.values >= 1).any(0, keepdims=True)) if stored.full_scale else None,
        tuple(filter(None, (stored.about, decoded, *converted))),
    )


def _linear(
    path: Path, stored: Stored, transfer: Transfer | None, allow_ldr: bool | None, encoding: Encoding | None
) -> tuple[np.ndarray, str]:
    """Decoded values, and how."""
    if encoding is not None and encoding not in get_args(Encoding):
        raise ValueError(f"encoding must be one of {', '.join(get_args(Encoding))}, got {encoding!r}")
    if not stored.full_scale:
        if encoding not in (None, "linear"):
            raise ValueError(f"{path}: its values are floating-point and taken as linear; leave --encoding out")
        if transfer not in (None, LINEAR) and encoding is None:
            raise ValueError(
                f"{path}: its profile names a curve ({transfer.name}) for its floating-point values; export it linear, "
                'or pass --encoding linear (encoding="linear" in Python) where it is'
            )
        return stored.values, ""
    if encoding is not None:
        transfer = DECODERS[encoding]
    elif not allow_ldr:
        cure = (
            "; --allow-ldr is for photographs alone"
            if allow_ldr is None
            else f", merge several exposures with `torchbrdf merge`, or pass --allow-ldr (allow_ldr=True in Python) to "
            f"decode it with {(transfer or _UNSAID).name}"
        )
        raise ValueError(f"{path}: {stored.kind} is not linear HDR; give an .exr or .hdr image{cure}")
    transfer = transfer or _UNSAID
    return transfer.decode(stored.values).astype(np.float32), f"{stored.kind} decoded with {transfer.name}"


def _converted(values: np.ndarray, source: Primaries, wanted: ColourSpace) -> tuple[np.ndarray, list[str]]:
    """Values in another space, and what was done: which it was, and how many pixels lie outside the new one."""
    target = space_named(wanted)
    if source.agrees(target):
        return values, []
    finite = np.isfinite(values).all(axis=0)
    matrix = conversion(source, target).astype(np.float32)
    with np.errstate(invalid="ignore", over="ignore"):
        converted = np.where(finite, np.tensordot(matrix, values, axes=1), values)
    outside = int((finite & (converted < 0).any(axis=0) & (values >= 0).all(axis=0)).sum())
    said = [f"{source} to {wanted}"]
    if outside:
        said.append(f"{outside} of its {finite.size} pixels have colours outside {wanted}, negative there")
    return converted, said


def read_metadata(path: str | os.PathLike[str]) -> dict[str, str]:
    """The text attributes of an .exr file's first part, as `write_image` takes them; what OpenEXR itself needs is not.

    raises     FileNotFoundError; ValueError when the file is not an OpenEXR image
    """
    path = existing_file(path, "an OpenEXR image")
    if path.suffix.lower() != ".exr":
        raise ValueError(f"{path}: image suffix {path.suffix!r} is not supported; use .exr")
    header: Mapping[str, object] = read_headers(path)[0]
    return {key: value for key, value in header.items() if isinstance(value, str) and key not in OWN_KEYS}


def read_environment_map(path: str | os.PathLike[str]) -> EnvironmentMap | None:
    """What an .exr file's `envmap` attribute says; None where it has none. Raises as `read_metadata`."""
    import OpenEXR

    kinds: dict[object, EnvironmentMap] = {OpenEXR.ENVMAP_LATLONG: "latlong", OpenEXR.ENVMAP_CUBE: "cube"}
    kind = read_headers(Path(path))[0].get("envmap")  # of any type, in files of others
    return kinds[kind] if isinstance(kind, type(OpenEXR.ENVMAP_CUBE)) else None
