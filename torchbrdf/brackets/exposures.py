"""How much light each frame of a bracket got, by the times of its files or those given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import log2
from pathlib import Path

import numpy as np

from torchbrdf.images import Shooting

_ROUNDED = 0.07
"""Cameras show 1/64 s as 1/60, and f/5.66 as 5.6."""
_SAME = 1e-3


@dataclass(frozen=True)
class Exposures:
    """Exposures of frames, by which their linear values are divided.

    said   (F,)  as times, speeds and apertures say: t ISO / (100 N^2), without what no file says
    exact  (F,)  the same with times and apertures at the whole, half or third stops that they are rounded from
    unit   of radiance
    """

    said: np.ndarray
    exact: np.ndarray
    unit: str

    @classmethod
    def of(cls, paths: Sequence[Path], shootings: Sequence[Shooting], times: Sequence[float] | None) -> Exposures:
        """From EXIF data, or from times given in their place.

        Raises ValueError where they are missing, are no times, do not go together, or are all the same.
        """
        if times is not None and len(times) != len(paths):
            raise ValueError(
                f"--times needs one for every file, in their order: got {len(times)} for {len(paths)} files"
            )
        found = list(times) if times is not None else [_needed(*pair) for pair in zip(paths, shootings, strict=True)]
        for path, time in zip(paths, found, strict=True):
            if not 0 < time < float("inf"):
                raise ValueError(
                    f"{path}: an exposure time of {time:g} s; give the seconds of all files, above 0, in their order: "
                    "--times"
                )
        isos = _common("ISO speed", paths, [one.iso for one in shootings])
        apertures = _common("f-number", paths, [one.f_number for one in shootings])
        said = _products(found, isos, apertures)
        exact = _products(
            found if times is not None else [_at_stop(t, 1) for t in found],
            isos,
            [_at_stop(n, 2) for n in apertures] if apertures else None,
        )
        if said.max() < (1 + _SAME) * said.min():
            raise ValueError(
                f"{paths[0]} and the other {len(paths) - 1} have the same exposure ({found[0]:.4g} s): give some that "
                "differ, or their true times with --times"
            )
        known = ["N^2" if apertures else "", "100/ISO" if isos else ""]
        return cls(said, exact, " ".join(filter(None, [*known, "1/s"])))

    def of_frames(self, chosen: Sequence[int] | np.ndarray) -> Exposures:
        """Those of some frames, in this order."""
        return Exposures(self.said[chosen], self.exact[chosen], self.unit)


def _needed(path: Path, shooting: Shooting) -> float:
    if shooting.time_s is None:
        raise ValueError(
            f"{path}: says no exposure time (EXIF); give the seconds of all files, in their order: --times"
        )
    return shooting.time_s


def _common(name: str, paths: Sequence[Path], values: Sequence[float | None]) -> list[float] | None:
    """Those of all files; None where no file says it."""
    known = [value for value in values if value is not None]
    if len(known) == len(values):
        return known
    if known:
        silent = paths[[value is None for value in values].index(True)]
        raise ValueError(
            f"{silent}: says no {name} (EXIF), and others of the set do: export all alike, or remove it from all"
        )
    return None


def _products(times: Sequence[float], isos: Sequence[float] | None, apertures: Sequence[float] | None) -> np.ndarray:
    speed = np.array(isos or [100.0]) / 100
    return np.array(times) * speed / np.array(apertures or [1.0]) ** 2


def _at_stop(value: float, per_octave: int) -> float:
    """The third, else the half stop that is shown as this value; the value itself where none is near.

    per_octave  how many stops a factor of 2 is
    """
    for fraction in (3, 2):
        exact: float = 2.0 ** (round(fraction * per_octave * log2(value)) / (fraction * per_octave))
        if abs(exact / value - 1) < _ROUNDED / per_octave:
            return exact
    return value
