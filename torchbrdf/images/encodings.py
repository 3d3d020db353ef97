"""How integers of a picture stand for radiance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from torchbrdf.images.display import DISPLAY_GAMMA
from torchbrdf.images.settings import Encoding


@dataclass(frozen=True)
class Transfer:
    """A function from encoded values in [0, 1] to linear ones, and its name."""

    name: str
    decode: Callable[[np.ndarray], np.ndarray]

    @classmethod
    def power(cls, gamma: float) -> Transfer:
        """The power function with this exponent."""
        return cls(f"gamma {gamma:.3g}", lambda values: values**gamma) if gamma != 1 else LINEAR


def _srgb(values: np.ndarray) -> np.ndarray:
    """The curve of IEC 61966-2-1."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


LINEAR = Transfer("linear", lambda values: values)
SRGB = Transfer("sRGB", _srgb)

DECODERS: dict[Encoding, Transfer] = {"linear": LINEAR, "srgb": SRGB, "gamma2.2": Transfer.power(DISPLAY_GAMMA)}
"""What `--encoding` names."""
