"""Simulated brackets: radiance, a sensor with noise, a camera's curve, files with EXIF data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

FULL_WELL = 20_000
"""Electrons of a pixel at clipping."""
READ_NOISE = 4.0


def srgb(linear: np.ndarray) -> np.ndarray:
    """The curve of IEC 61966-2-1."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def s_shaped(linear: np.ndarray) -> np.ndarray:
    """A toe and a shoulder, as a camera's standard picture style has on top of sRGB."""
    power = 2.2
    toned = srgb(linear) ** power
    return toned / (toned + 0.42**power) * (1 + 0.42**power)


CURVES: dict[str, Callable[[np.ndarray], np.ndarray]] = {"srgb": srgb, "s-shaped": s_shaped, "linear": lambda x: x}


@dataclass(frozen=True)
class Camera:
    """How photographs are taken.

    curve    of CURVES
    suffix   of the files
    noise    of photons and of reading, over that of a full well of FULL_WELL electrons
    quality  of JPEG
    bits     of PNG and TIFF
    exif     what all files say beside the time
    """

    curve: str = "srgb"
    suffix: str = ".jpg"
    noise: float = 1.0
    quality: int = 95
    bits: int = 8
    exif: dict[int, object] = field(default_factory=dict)

    def expose(self, radiance: np.ndarray, exposure: float, random: np.random.Generator) -> np.ndarray:
        """Codes of (H, W, 3) radiance that is clipped at 1 over the exposure."""
        electrons = np.clip(radiance * exposure, 0, 2) * FULL_WELL
        noise = np.sqrt(electrons + READ_NOISE**2) * random.standard_normal(electrons.shape)
        linear = np.clip((electrons + self.noise * noise) / FULL_WELL, 0, 1)
        top = 2**self.bits - 1
        return np.rint(np.clip(CURVES[self.curve](linear), 0, 1) * top).astype(
            np.uint8 if self.bits == 8 else np.uint16
        )

    def take(self, path: Path, radiance: np.ndarray, exposure: float, random: np.random.Generator) -> Path:
        """Write one photograph, whose EXIF data say its time."""
        self.save(path.with_suffix(self.suffix), self.expose(radiance, exposure, random), exposure)
        return path.with_suffix(self.suffix)

    def save(self, path: Path, codes: np.ndarray, time_s: float) -> None:
        """Write codes as they are."""
        exif = Image.Exif()
        exif[0x010F], exif[0x0110] = "Maker", "Model One"
        exif.get_ifd(0x8769).update({0x829A: IFDRational(round(time_s * 10**6), 10**6), **self.exif})
        if codes.dtype == np.uint16:
            import tifffile

            tags = [(33434, "2I", 1, (round(time_s * 10**6), 10**6), True)]
            tifffile.imwrite(path, codes, photometric="rgb", extratags=tags, metadata=None)
        else:
            Image.fromarray(codes).save(path, exif=exif, quality=self.quality, subsampling=0)


def moved(radiance: np.ndarray, x: float, y: float, turn_deg: float = 0.0) -> np.ndarray:
    """(H, W, 3) as a camera sees it that shows at (x, y) farther on, about the middle, what was there before."""
    import cv2

    height, width = radiance.shape[:2]
    matrix = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), -turn_deg, 1.0)
    matrix[:, 2] += np.array([x, y])
    return np.asarray(
        cv2.warpAffine(radiance, matrix, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    ).clip(1e-6)


def bracket(
    folder: Path,
    radiance: np.ndarray,
    times: Sequence[float],
    camera: Camera,
    motions: Sequence[tuple[float, ...]] | None = None,
    seed: int = 0,
) -> list[Path]:
    """Write a bracket of (H, W, 3) radiance; motions (x, y) or (x, y, degrees) for each."""
    random = np.random.default_rng(seed)
    shown = [
        radiance if not any(motion) else moved(radiance, *motion) for motion in motions or [(0.0, 0.0)] * len(times)
    ]
    return [
        camera.take(folder / f"IMG_{k}", one, time, random)
        for k, (one, time) in enumerate(zip(shown, times, strict=True))
    ]


def texture(height: int = 160, width: int = 240, decades: float = 3.0, seed: int = 0) -> np.ndarray:
    """(H, W, 3) radiance of soft coloured patches over some decades, median 1."""
    import cv2

    random = np.random.default_rng(seed)
    grey, colour = random.standard_normal((height, width, 1)), 0.1 * random.standard_normal((height, width, 3))
    logs = np.asarray(cv2.GaussianBlur(grey + colour, (0, 0), 5), dtype=np.float32)
    ranks = decades / np.ptp(logs) * np.log(10) * (logs - np.median(logs))
    return np.asarray(np.exp(ranks), dtype=np.float32)
