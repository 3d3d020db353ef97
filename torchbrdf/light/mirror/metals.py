"""How much of the light a metal reflects, from n and k of Mitsuba's data."""

from __future__ import annotations

import re
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from importlib.machinery import PathFinder
from math import pi
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

_WAVELENGTHS = np.arange(380.0, 781.0, 5.0)
_ANGLES = 257

_POLISHED = {
    "aluminium": "Al",
    "aluminum": "Al",
    "chrome": "Cr",
    "chromium": "Cr",
    "copper": "Cu",
    "gold": "Au",
    "nickel": "Ni_palik",
    "silver": "Ag",
}
"""What mirror balls are made of or coated with, in words."""


_PALIK = "_palik"
"""The end of names whose data are by another author, some beside those of the same element."""

_ELEMENT = re.compile(f"[A-Z][a-z]?(?:{_PALIK})?")


@dataclass(frozen=True)
class Metal:
    """A polished metal.

    name  as Mitsuba's, such as "Al" or "Cr"
    n, k  real and imaginary part of the index of refraction at wavelengths from 380 to 780 nm
    """

    name: str
    n: np.ndarray
    k: np.ndarray

    @classmethod
    def open(cls, name: str) -> Metal:
        """From the data that Mitsuba ships. Raises ValueError for an unknown name, OSError where there are no data."""
        folder = _folder()
        names = sorted({path.name.removesuffix(".eta.spd") for path in folder.glob("*.eta.spd")})
        if name not in names:
            raise ValueError(f"no metal {name!r} in Mitsuba's data; {_meant(name, names)}")
        return cls(name, *(_spectrum(folder / f"{name}.{part}.spd") for part in ("eta", "k")))

    def __str__(self) -> str:
        """For people."""
        straight = ", ".join(f"{share:.2f}" for share in self.reflectance(torch.zeros(())).tolist())
        return f"{self.name} (reflects {straight} at normal incidence)"

    def reflectance(self, angles: Tensor) -> Tensor:
        """(..., 3): the share of light in linear Rec. 709 that is reflected at angles of incidence (...) in radians."""
        place = (angles * ((_ANGLES - 1) / (pi / 2))).clamp(0, _ANGLES - 1)
        first = place.detach().floor().clamp_max(_ANGLES - 2)
        table = self._by_angle.to(angles)
        return torch.lerp(table[first.long()], table[first.long() + 1], (place - first)[..., None])

    @cached_property
    def _by_angle(self) -> Tensor:
        """(N, 3) at angles from 0 to pi / 2: of light of all wavelengths alike, whose colours are those of a white."""
        cosine = np.cos(np.linspace(0, pi / 2, _ANGLES))[:, None]
        sensitivity = _rec709()
        return torch.from_numpy(fresnel(cosine, self.n, self.k) @ sensitivity.T).clamp(0, 1)


def fresnel(cosine: np.ndarray, n: np.ndarray, k: np.ndarray) -> np.ndarray:
    """The unpolarised reflectance of a conductor in air, from the complex amplitudes of both polarisations."""
    index = n + 1j * k
    inside = np.sqrt(index**2 - (1 - cosine**2))
    across = (cosine - inside) / (cosine + inside)
    along = (index**2 * cosine - inside) / (index**2 * cosine + inside)
    reflected: np.ndarray = (abs(across) ** 2 + abs(along) ** 2) / 2
    return reflected


def _meant(name: str, names: list[str]) -> str:
    """What to give in the place of a name that is none."""
    elements = {one.removesuffix(_PALIK): one for one in reversed(names) if _ELEMENT.fullmatch(one)}
    by_word = {one.casefold(): called for one, called in elements.items()}
    by_word |= {one.casefold(): one for one in names} | _POLISHED
    if close := get_close_matches(name.casefold(), by_word, n=2, cutoff=0.7):
        return f"did you mean {' or '.join(dict.fromkeys(by_word[word] for word in close))}?"
    usual = sorted({*_POLISHED.values()} & {*names})
    others = sorted({*elements.values()} - {*usual})
    return f"mirror balls are of {', '.join(usual)}; others are {', '.join(others)}"


def _folder() -> Path:
    """Where an installed Mitsuba keeps its spectra, without importing it."""
    found = PathFinder.find_spec("mitsuba")  # of an imported one the spec is its variant's
    folder = Path((found.submodule_search_locations or [""])[0]) / "data" / "ior" if found else Path("mitsuba")
    if not folder.is_dir():
        raise OSError(f"{folder}: no data of metals here; install mitsuba, or give --mirror-reflectance R")
    return folder


def _spectrum(path: Path) -> np.ndarray:
    """At the wavelengths that are summed over."""
    at, values = np.loadtxt(path, comments="#", ndmin=2).T
    return np.interp(_WAVELENGTHS, at, values)


def _rec709() -> np.ndarray:
    """(3, N): how much each wavelength adds to linear R, G and B; rows sum to 1.

    CIE 1931's colour matching functions by the Gaussians of [WSS13, tab. 1].
    """

    def lobe(mean: float, below: float, above: float) -> np.ndarray:
        off = (_WAVELENGTHS - mean) * np.where(mean > _WAVELENGTHS, below, above)
        gaussian: np.ndarray = np.exp(-(off**2) / 2)
        return gaussian

    x = 0.362 * lobe(442.0, 0.0624, 0.0374) + 1.056 * lobe(599.8, 0.0264, 0.0323) - 0.065 * lobe(501.1, 0.0490, 0.0382)
    y = 0.821 * lobe(568.8, 0.0213, 0.0247) + 0.286 * lobe(530.9, 0.0613, 0.0322)
    z = 1.217 * lobe(437.0, 0.0845, 0.0278) + 0.681 * lobe(459.0, 0.0385, 0.0725)
    to_rgb = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
    rgb = to_rgb @ np.stack([x, y, z])
    weights: np.ndarray = rgb / rgb.sum(1, keepdims=True)
    return weights
