"""How a photograph was taken, by what its file says: EXIF data, or the attributes of an .exr file."""

from __future__ import annotations

import os
import struct
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from math import hypot, isfinite
from pathlib import Path
from typing import Any

from torchbrdf.files import existing_file
from torchbrdf.images.formats import exif_of, read_headers

RAW_SUFFIXES = (
    ".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dng", ".erf", ".iiq", ".kdc", ".mos", ".mrw", ".nef", ".nrw", ".orf",
    ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f",
)  # fmt: skip
"""Of camera RAW, which LibRaw reads."""

_FULL_FRAME_MM = hypot(36, 24)
"""The diagonal that focal lengths "in 35 mm film" are for [EXIF]."""
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}
_SENSOR_MM = (2.0, 70.0)
"""Widths of sensors; other numbers of pixels a millimetre are none."""
_AGREE = 0.1
"""The two ways to the angle of view may differ by so much: a focal length in 35 mm film is a whole number."""
_SAME_SHAPE = 0.01
_SHAPES = (1, 5 / 4, 4 / 3, 3 / 2, 16 / 9, 256 / 135, 2)
"""Of the pictures that cameras take: the longer side over the shorter."""
_ERRORS = (OSError, ValueError, SyntaxError, LookupError, TypeError, ArithmeticError, AttributeError, struct.error)
"""What Pillow raises for damaged EXIF data."""

_LARGEST_SHORT = 65535
_EXIF_DATA = 0x8769


@dataclass(frozen=True)
class Shooting:
    """How a photograph was taken; None or empty where the file does not say.

    time_s         exposure time, seconds
    f_number       focal length over aperture
    iso            speed
    focal_mm       focal length
    focal_35mm_mm  focal length at which a 36 x 24 mm frame has the same angle of view across the diagonal
    size           (height, width) of the original as it is shown
    pitch_mm       distance between pixels of the original on the sensor
    camera         maker and model
    white_balance  "auto" or "manual"
    """

    time_s: float | None = None
    f_number: float | None = None
    iso: float | None = None
    focal_mm: float | None = None
    focal_35mm_mm: float | None = None
    size: tuple[int, int] | None = None
    pitch_mm: float | None = None
    camera: str = ""
    white_balance: str = ""

    def focal_pixels(self, size: tuple[int, int]) -> float:
        """The focal length in pixels of a picture (height, width) that shows all of the original, perhaps resized.

        Raises ValueError, for a message that begins with the file, where the angle of view is not known or not sure.
        """
        height, width = self.size or size
        if abs(size[0] * width / (size[1] * height) - 1) > _SAME_SHAPE:
            raise ValueError(
                f"is {size[0]} x {size[1]} and was {height} x {width} when it was taken: it is cropped, and its EXIF "
                "data do not say where"
            )
        found = []
        if self.focal_mm and self.pitch_mm:
            found.append(self.focal_mm / self.pitch_mm)
        if self.focal_35mm_mm:
            found.append(self.focal_35mm_mm / _FULL_FRAME_MM * hypot(height, width))
        if not found:
            lacking = "does not say how large the sensor is" if self.focal_mm else "names no focal length"
            raise ValueError(lacking)
        if max(found) > (1 + _AGREE) * min(found):
            raise ValueError(
                f"its EXIF data contradict one another: a focal length of {found[0]:.0f} pixels by the pixels' pitch, "
                f"and of {found[1]:.0f} by that in 35 mm film"
            )
        return found[0] * size[1] / width

    def doubt(self, size: tuple[int, int]) -> str | None:
        """Why a picture (height, width) may not show all of the original, as `focal_pixels` takes it to; None if none.

        In words for a message that begins with the file.
        """
        height, width = self.size or size
        if (height, width) != size:
            return f"is {size[0]} x {size[1]} and was {height} x {width} when it was taken: it is read as resized"
        shape = max(size) / min(size)
        if all(abs(shape / known - 1) > _SAME_SHAPE for known in _SHAPES):
            return f"is {size[0]} x {size[1]}, a shape that no camera takes: it is read as whole all the same"
        return None

    def attributes(self) -> dict[str, str | float]:
        """What `read_shooting` finds in an .exr file with these attributes, as `write_image` takes them."""
        height, width = self.size or (None, None)
        named = {
            "expTime": self.time_s,
            "aperture": self.f_number,
            "isoSpeed": self.iso,
            "nominalFocalLength": self.focal_mm,
            "Exif:FocalLengthIn35mmFilm": self.focal_35mm_mm,
            "Exif:PixelXDimension": width,
            "Exif:PixelYDimension": height,
            "sensorPhotositePitch": None if self.pitch_mm is None else 1e3 * self.pitch_mm,
        }
        texts = {"cameraModel": self.camera, "Exif:WhiteBalance": self.white_balance}
        return {key: float(value) for key, value in named.items() if value} | {k: v for k, v in texts.items() if v}


def read_shooting(path: str | os.PathLike[str]) -> Shooting:
    """How a photograph was taken, by EXIF data of JPEG, TIFF, PNG and camera RAW, or attributes of OpenEXR.

    Nothing is known of files of other kinds. Raises as `existing_file`; ValueError where an .exr file is damaged.
    """
    path = existing_file(path, "a photograph")
    if path.suffix.lower() == ".exr":
        return _of_header(read_headers(path)[0])
    found = _of_exif(path)
    if found == Shooting() and path.suffix.lower() in RAW_SUFFIXES and find_spec("rawpy"):
        return _of_raw(path)
    return found


def _of_exif(path: Path) -> Shooting:
    from PIL import Image

    exif = Image.Exif()
    try:
        with warnings.catch_warnings(action="ignore"):
            if path.suffix.lower() in (".tif", ".tiff", *RAW_SUFFIXES):
                with open(path, "rb") as file:
                    exif.load_from_fp(file)
                    return _of_tags({**exif, **exif.get_ifd(_EXIF_DATA)})
            exif.load(exif_of(path))
            return _of_tags({**exif, **exif.get_ifd(_EXIF_DATA)})
    except _ERRORS:
        return Shooting()


def _of_tags(tags: Mapping[int, Any]) -> Shooting:
    """From the tags of the picture and of its EXIF data [EXIF]."""
    number = partial(_number, tags)
    width, height = number(0xA002), number(0xA003)
    resolution = number(0xA20E)
    pitch = _UNIT_MM.get(int(number(0xA210) or 2), 0.0) / resolution if resolution else 0.0
    believed = width is not None and _SENSOR_MM[0] < width * pitch < _SENSOR_MM[1]
    sensitivity = number(0x8827)
    if sensitivity in (None, _LARGEST_SHORT):  # more does not fit there
        sensitivity = number(0x8832) or number(0x8831) or number(0x8833) or sensitivity
    shown = (width, height) if tags.get(0x0112) in (5, 6, 7, 8) else (height, width)
    return Shooting(
        time_s=number(0x829A) or _power(tags.get(0x9201), lambda apex: 2**-apex),
        f_number=number(0x829D) or _power(tags.get(0x9202), lambda apex: 2 ** (apex / 2)),
        iso=sensitivity,
        focal_mm=number(0x920A),
        focal_35mm_mm=number(0xA405),
        size=(int(shown[0]), int(shown[1])) if shown[0] and shown[1] else None,
        pitch_mm=pitch if believed else None,
        camera=_camera(tags.get(0x010F), tags.get(0x0110)),
        white_balance={0: "auto", 1: "manual"}.get(tags.get(0xA403, -1), ""),
    )


def _of_header(header: Mapping[str, Any]) -> Shooting:
    """From attributes of OpenEXR, under the names of [EXR] or those that OpenImageIO gives to EXIF data."""

    def number(*names: str) -> float | None:
        return next(filter(None, (_number(header, name) for name in names)), None)

    maker, model = (header.get(f"camera{name}") or header.get(name) for name in ("Make", "Model"))
    width, height = number("Exif:PixelXDimension"), number("Exif:PixelYDimension")
    pitch = number("sensorPhotositePitch")
    return Shooting(
        time_s=number("expTime", "ExposureTime"),
        f_number=number("aperture", "FNumber"),
        iso=number("isoSpeed", "Exif:PhotographicSensitivity", "Exif:ISOSpeedRatings"),
        focal_mm=number("nominalFocalLength", "Exif:FocalLength"),
        focal_35mm_mm=number("Exif:FocalLengthIn35mmFilm"),
        size=(int(height), int(width)) if width and height else None,
        pitch_mm=1e-3 * pitch if pitch else None,
        camera=_camera(maker, model),
        white_balance=str(header.get("Exif:WhiteBalance", "")),
    )


def _of_raw(path: Path) -> Shooting:
    """By LibRaw, for files that are not of TIFF's kind."""
    import rawpy

    try:
        with rawpy.imread(str(path)) as raw:
            if not hasattr(raw, "other"):  # rawpy before 0.27
                return Shooting()
            number = partial(_number, raw.other._asdict())
    except (rawpy.LibRawError, OSError):
        return Shooting()
    return Shooting(number("shutter_speed"), number("aperture"), number("iso_speed"), number("focal_length"))


def _number(values: Mapping[Any, Any], key: object) -> float | None:
    """A positive number; None for 0 and infinity, by which EXIF data say that it is not known."""
    value = values.get(key)
    try:
        number = float(value[0] if isinstance(value, tuple) else value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ArithmeticError, IndexError):
        return None
    return number if isfinite(number) and number > 0 else None


def _power(apex: object, of: Callable[[float], float]) -> float | None:
    """What an APEX value, a logarithm to base 2, stands for."""
    try:
        return _number({"apex": of(float(apex))}, "apex") if apex is not None else None  # type: ignore[arg-type]
    except (TypeError, ValueError, ArithmeticError):
        return None


def _camera(maker: object, model: object) -> str:
    """Both in a few words: models often begin with their maker."""
    names = [str(name).strip("\0 ") for name in (maker, model) if name]
    if len(names) == 2 and names[1].casefold().startswith(names[0].split(" ")[0].casefold()):
        names = names[1:]
    return " ".join(name for name in names if name)
