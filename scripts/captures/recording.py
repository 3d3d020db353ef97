"""What a camera makes of radiance: noise, exposures of 8 bits with a response curve and EXIF, moved by the hand."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, floor, log2
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

NOISE = 0.01
"""Of the linear photograph where it is as bright as the ball on average; shot noise, so relatively less if brighter."""

_READ_NOISE = 0.0005
_FULL_WELL = 40_000
_READ_ELECTRONS = 5
_S_STRENGTH = 0.4
_GREY = 0.18
_BASE_TIME = Fraction(1, 60)
_MOST_EXPOSURES = 9
_SENSOR_WIDTH_MM = 23.5
_FILM_WIDTH_MM = 36.0

RESPONSES = ("srgb", "s-curve")


def noisy(image: Tensor, level: float, generator: np.random.Generator) -> Tensor:
    """The linear photograph (3, H, W) with shot and read noise; `level` is the radiance at which it is NOISE."""
    variance = NOISE**2 * level * image.double().numpy() + (_READ_NOISE * level) ** 2
    e = generator.standard_normal(image.shape)
    return (image.double() + torch.from_numpy(np.sqrt(variance) * e)).clamp_min(0).float()


def respond(exposure: np.ndarray, response: str) -> np.ndarray:
    """Values in [0, 1] that the camera stores of exposures, which saturate at 1. Rises everywhere."""
    x = np.clip(exposure, 0, 1)
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    if response == "srgb":
        return encoded
    return encoded + _S_STRENGTH * (encoded * encoded * (3 - 2 * encoded) - encoded)


@dataclass(frozen=True)
class Exposure:
    """One bracket: stops above the base time, and by how much the picture moved to the right and down, in pixels."""

    stops: int
    moved: tuple[float, float] = (0.0, 0.0)

    @property
    def time(self) -> Fraction:
        """Seconds."""
        return _BASE_TIME * Fraction(2) ** self.stops


def brackets_of(
    image: Tensor, ball: Tensor, level: float, shift: float, generator: np.random.Generator
) -> list[Exposure]:
    """Exposures from where nothing of the picture saturates to where the ball's dark parts are bright.

    image  (3, H, W); ball: (3, P), its pixels on the ball; level: radiance that is medium grey at the base time
    shift  pixels, at most, of all but the one nearest to the base time
    """
    brightest, dark = float(image.max()) / level * _GREY, float(ball.mean(0).quantile(0.05)) / level * _GREY
    lowest = min(0, floor(log2(0.85 / brightest)))
    highest = max(0, min(6, ceil(log2(0.1 / max(dark, 1e-6)))))
    step = 2 if (highest - lowest) / 2 + 1 <= _MOST_EXPOSURES else 3
    stops = list(range(highest, lowest - step, -step))[::-1]
    base = min(stops, key=abs)
    moves = [(0.0, 0.0) if one == base else _move(generator, shift) for one in stops]
    return [Exposure(one, move) for one, move in zip(stops, moves, strict=True)]


def _move(generator: np.random.Generator, shift: float) -> tuple[float, float]:
    x, y = generator.uniform(-shift, shift, 2).tolist()
    return x, y


def recorded(
    image: Tensor, level: float, exposure: Exposure, response: str, margin: int, generator: np.random.Generator
) -> np.ndarray:
    """(H, W, 3) uint8: one bracket of a picture (3, H + 2 margin, W + 2 margin)."""
    import cv2

    pixels = image.permute(1, 2, 0).double().numpy()
    if any(exposure.moved):
        (x, y), (height, width) = exposure.moved, pixels.shape[:2]
        move = np.array([[1, 0, x], [0, 1, y]], dtype=float)
        pixels = cv2.warpAffine(pixels, move, (width, height), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    if margin:
        pixels = pixels[margin:-margin, margin:-margin]
    electrons = pixels / level * _GREY * 2.0**exposure.stops * _FULL_WELL
    deviation = np.sqrt(np.minimum(electrons, _FULL_WELL) + _READ_ELECTRONS**2)
    electrons = electrons + deviation * generator.standard_normal(electrons.shape)
    return np.asarray(np.round(255 * respond(electrons / _FULL_WELL, response)), dtype=np.uint8)


def write_bracket(path: Path, pixels: np.ndarray, exposure: Exposure, fov_deg: float) -> None:
    """A .jpg or .png with EXIF: exposure time, aperture, ISO, and both focal lengths."""
    from PIL import Image
    from PIL.TiffImagePlugin import IFDRational

    film = _FILM_WIDTH_MM / 2 / np.tan(np.radians(fov_deg) / 2)
    own = film * _SENSOR_WIDTH_MM / _FILM_WIDTH_MM
    exif = Image.Exif()
    exif[_MAKE], exif[_MODEL] = "torchbrdf", "simulated camera"
    exif.get_ifd(_EXIF).update(
        {
            _EXPOSURE_TIME: IFDRational(exposure.time.numerator, exposure.time.denominator),
            _F_NUMBER: IFDRational(8, 1),
            _ISO: 100,
            _FOCAL_LENGTH: IFDRational(round(100 * own), 100),
            _FOCAL_LENGTH_35: round(film),
        }
    )
    Image.fromarray(pixels).save(path, exif=exif, quality=95, subsampling=0)  # .png knows neither


_MAKE, _MODEL, _EXIF = 0x010F, 0x0110, 0x8769
_EXPOSURE_TIME, _F_NUMBER, _ISO, _FOCAL_LENGTH, _FOCAL_LENGTH_35 = 0x829A, 0x829D, 0x8827, 0x920A, 0xA405


def described(files: Sequence[str], exposures: Sequence[Exposure]) -> list[dict[str, object]]:
    """For truth.json."""
    return [
        {"file": file, "seconds": float(exposure.time), "moved": list(exposure.moved)}
        for file, exposure in zip(files, exposures, strict=True)
    ]
