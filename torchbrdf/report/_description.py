"""What a result is, in words: which materials of the library look like it, how glossy it is, its colour."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi

import numpy as np
from torch import Tensor

from torchbrdf.brdf import GRID, MerlTable, cell_centres
from torchbrdf.images import LUMINANCE, tone_map
from torchbrdf.transport import BasisImages, own_images

_THETA_D = 30
"""Row of theta_d, in degrees, of the curve that tells gloss: measured well, far from grazing."""

PEAK = 2
"""Cells in theta_h whose mean stands for the top of the highlight."""

BESIDE_DEG = (45.0, 75.0)
"""theta_h in degrees between which lies what is not highlight."""

_NO_HIGHLIGHT = 1.5
"""Times what lies beside it: below, the highlight is none to speak of."""

_WIDTHS = ((0.5, "sharp"), (3.0, "narrow"), (8.0, "soft"), (float("inf"), "broad"))
"""Half widths in theta_h, in degrees, up to which a highlight is called so."""

_NARROWEST = 0.5
"""Degrees: narrower is said to be so, as the cells and the pixels hold no more."""


_SAME = 0.015
"""Relative RMS difference up to which a photograph shows what the library holds: no other measurement comes as near."""

_PLATEAU, _CLIPPED, _ABOVE = 1e-3, 4, 0.02
"""Pixels within such a share of the brightest, so many of them, and how much brighter the fit is there: clipped."""


@dataclass(frozen=True, eq=False)
class Alike:
    """A material of the library, how much it differs from a photograph in display values, and its picture there."""

    name: str
    difference: float
    image: Tensor


@dataclass(frozen=True)
class Gloss:
    """A highlight over theta_h at theta_d = 30 degrees.

    width     degrees of theta_h from its middle to where it is half as bright
    contrast  its top over what lies beside it
    beside    (3,)  pi f_r there: the albedo of a matt surface that is as bright
    """

    width: float
    contrast: float
    beside: tuple[float, float, float]

    @property
    def matt(self) -> bool:
        """Whether there is no highlight to speak of."""
        return self.contrast < _NO_HIGHLIGHT

    def __str__(self) -> str:
        """What it is, in words."""
        if self.matt:
            return "Matt, without a highlight to speak of"
        word = next(word for width, word in _WIDTHS if self.width < width)
        reach = f"{self.width:.1f}°" if self.width >= _NARROWEST else f"less than {_NARROWEST:g}°"
        return f"Glossy: a {word} highlight, half as bright {reach} from its middle"


def most_alike(fitted: Tensor, used: Tensor, exposure: float, basis: BasisImages, count: int = 3) -> list[Alike]:
    """The library's materials that look most like a photograph under its own light, the nearest first.

    fitted  (3, H, W)  the photograph as the result explains it
    used    (1, H, W) bool
    The difference is the RMS of display values, from 0 to 1, at the exposure.
    """
    inside = basis.pack(used.to(basis.mask.device))[0]
    images = own_images(basis.packed.detach())
    shown = tone_map(basis.pack(fitted.to(images))[:, inside], exposure)
    gaps = (tone_map(images[..., inside], exposure) - shown).square().mean((1, 2)).sqrt()
    nearest = gaps.argsort(stable=True)[:count].tolist()
    return [Alike(basis.names[i], float(gaps[i]), basis.unpack(images[i]).cpu()) for i in nearest]


def held_by_library(photograph: Tensor, used: Tensor, basis: BasisImages) -> str | None:
    """The material of the library that a photograph shows, if any: to be recovered, it has to be left out.

    photograph  (3, H, W) linear radiance
    used        (1, H, W) bool
    """
    inside = basis.pack(used.to(basis.mask.device))[0]
    images = own_images(basis.packed.detach())[..., inside].double()
    y = basis.pack(photograph.to(images))[:, inside]
    gaps = (images - y).square().sum((1, 2))
    nearest = int(gaps.argmin())
    return basis.names[nearest] if float(gaps[nearest]) < _SAME**2 * float(y.square().sum()) else None


def gloss_of(table: MerlTable, first: int = 0) -> Gloss:
    """How glossy a BRDF is, from one row of its table, as if a highlight were as bright in its middle as in `first`.

    first  the first cell in theta_h of which the table tells
    """
    curve = table.filled.reshape(*GRID, 3)[:, _THETA_D].double().mean(1).cpu().numpy()
    theta_h = np.degrees(cell_centres()[0].ravel().numpy())
    flat = (theta_h > BESIDE_DEG[0]) & (theta_h < BESIDE_DEG[1])
    beside = np.median(curve[flat], axis=0)
    bright = curve @ np.asarray(LUMINANCE)
    rest, peak = float(np.median(bright[flat])), float(bright[first:][:PEAK].mean())
    bright[:first] = max(peak, bright[first])
    half = rest + (peak - rest) / 2
    below = np.flatnonzero(bright <= half)
    width = 90.0
    if len(below) and below[0] > 0:
        i = int(below[0])
        width = float(np.interp(half, [bright[i], bright[i - 1]], [theta_h[i], theta_h[i - 1]]))
    red, green, blue = (pi * beside).tolist()
    return Gloss(width, peak / rest if rest > 0 else float("inf"), (red, green, blue))


def looks_clipped(photograph: Tensor, fitted: Tensor, used: Tensor) -> bool:
    """Whether several pixels are as bright as the brightest of a photograph (3, H, W), and darker than the fit."""
    for y, fit in zip(photograph[:, used[0]], fitted[:, used[0]], strict=True):
        top = y > (1 - _PLATEAU) * y.max()
        if y.max() > 0 and int(top.sum()) >= _CLIPPED and float(fit[top].mean()) > (1 + _ABOVE) * float(y.max()):
            return True
    return False


def in_words(names: Sequence[str]) -> str:
    """a, b and c."""
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1]))) if names else ""
