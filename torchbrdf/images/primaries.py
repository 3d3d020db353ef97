"""Colour spaces: what R, G and B are, and linear RGB of one space in another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from torchbrdf.images.settings import ColourSpace
from torchbrdf.lasting import without_autocast

_SAME = 3e-3
"""Conversions closer than this to none are none: files round chromaticities to three digits, D65 varies in the fourth,
and a profile names them as adapted to D50."""

_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
"""From XYZ to the cone responses in which whites are adapted [Lam85]."""

Chromaticity = tuple[float, float]


@dataclass(frozen=True)
class Primaries:
    """A linear RGB space by the CIE 1931 chromaticities x, y of its primaries and of its white, (1, 1, 1).

    Raises ValueError where they span no space.
    """

    red: Chromaticity
    green: Chromaticity
    blue: Chromaticity
    white: Chromaticity

    def __post_init__(self) -> None:
        """Check that the primaries span a space that holds the white."""
        values = np.array(self.values)
        if not (np.isfinite(values).all() and abs(values).max() < 10 and self.white[1] > 0):
            raise ValueError(f"chromaticities must be finite, with a white above 0, got {self.values}")
        flat = abs(np.linalg.det(_xyz(values[:3]))) < 1e-6
        if flat or not (self._strengths() > 0).all() or not (_BRADFORD @ self.white_xyz() > 0).all():
            raise ValueError(f"these primaries span no colour space around their white: {self.values}")

    @classmethod
    def of(cls, numbers: tuple[float, ...]) -> Primaries:
        """From x and y of red, green, blue and white, eight numbers."""
        red, green, blue, white = zip(numbers[::2], numbers[1::2], strict=True)
        return cls(red, green, blue, white)

    def __str__(self) -> str:
        """The name, or else the chromaticities."""
        for name, space in SPACES.items():
            if self.agrees(space):
                return name
        return "primaries " + ", ".join(f"({x:.4g} {y:.4g})" for x, y in self.values)

    @property
    def values(self) -> tuple[Chromaticity, Chromaticity, Chromaticity, Chromaticity]:
        """Red, green, blue and white."""
        return self.red, self.green, self.blue, self.white

    def agrees(self, other: Primaries) -> bool:
        """Whether both give the same numbers for the same colours, up to the rounding of files."""
        return bool(np.abs(conversion(self, other) - np.eye(3)).max() < _SAME)

    def to_xyz(self) -> np.ndarray:
        """(3, 3) float64: from RGB to CIE XYZ with Y = 1 for the white."""
        return _xyz(np.array(self.values[:3])) * self._strengths()

    def _strengths(self) -> np.ndarray:
        """(3,): the sums X + Y + Z of the primaries that add up to the white."""
        return np.linalg.solve(_xyz(np.array(self.values[:3])), self.white_xyz())

    def white_xyz(self) -> np.ndarray:
        """(3,): XYZ of the white, with Y = 1."""
        return _xyz(np.array(self.white)[None])[:, 0] / self.white[1]


def _xyz(chromaticities: np.ndarray) -> np.ndarray:
    """(3, n): XYZ, in columns, of n chromaticities (n, 2), with X + Y + Z = 1."""
    x, y = chromaticities.T
    return np.stack([x, y, 1 - x - y])


def conversion(source: Primaries, target: Primaries) -> np.ndarray:
    """(3, 3) float64: from linear RGB of one space to another, whites adapted by Bradford's transform [Lam85]."""
    cones = (_BRADFORD @ target.white_xyz()) / (_BRADFORD @ source.white_xyz())
    adapted = np.linalg.solve(_BRADFORD, cones[:, None] * _BRADFORD)
    return np.linalg.solve(target.to_xyz(), adapted @ source.to_xyz())


def space_named(name: ColourSpace) -> Primaries:
    """Of the `SPACES`. Raises ValueError where it is none of them."""
    if name not in SPACES:
        raise ValueError(f"primaries must be one of {', '.join(SPACES)}, got {name!r}")
    return SPACES[name]


@without_autocast
def converted(image: Tensor, source: ColourSpace, target: ColourSpace) -> Tensor:
    """(3, ...) linear RGB of one space in another; see `conversion`. Raises ValueError for an unknown space."""
    before, after = space_named(source), space_named(target)
    if source == target:
        return image
    return torch.tensordot(torch.from_numpy(conversion(before, after)).to(image), image, dims=1)


_D65 = (0.3127, 0.3290)
_D60 = (0.32168, 0.33767)

SPACES: dict[ColourSpace, Primaries] = {
    "rec709": Primaries((0.640, 0.330), (0.300, 0.600), (0.150, 0.060), _D65),
    "rec2020": Primaries((0.708, 0.292), (0.170, 0.797), (0.131, 0.046), _D65),
    "p3-d65": Primaries((0.680, 0.320), (0.265, 0.690), (0.150, 0.060), _D65),
    "aces-ap0": Primaries((0.7347, 0.2653), (0.0, 1.0), (0.0001, -0.077), _D60),
    "aces-ap1": Primaries((0.713, 0.293), (0.165, 0.830), (0.128, 0.044), _D60),
    "xyz": Primaries((1.0, 0.0), (0.0, 1.0), (0.0, 0.0), (1 / 3, 1 / 3)),
}
"""By name: ITU-R BT.709 (and sRGB), BT.2020, SMPTE Display P3, ACES2065-1, ACEScg, CIE XYZ."""
