"""What no bracket is, and what harms one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from torchbrdf.arguments import warn
from torchbrdf.brackets._choice import Chosen
from torchbrdf.brackets.frames import Frame
from torchbrdf.brackets.response import Curve
from torchbrdf.brackets.samples import Samples
from torchbrdf.images import SRGB

_BLACK = 0.01
_WHITE = 0.98
_FEWEST = 50
_CLEARLY = 1.1
_BRIGHTNESS, _COLOUR, _APART = 0.05, 0.04, 0.04
_STEEPEST = 1.5
"""Power of sRGB's response beyond which a camera's is not believed; that of the captures' S-curve is 0.85."""


def check_same(frames: Sequence[Frame]) -> None:
    """Raise ValueError where files differ in what must be the same in a bracket; warn where it may harm."""
    first = frames[0]
    for other in frames[1:]:
        if other.codes.shape != first.codes.shape:
            sizes = [f"{one.codes.shape[0]} x {one.codes.shape[1]}" for one in (first, other)]
            raise ValueError(f"{other.path}: is {sizes[1]}, and {first.path} is {sizes[0]}: give exposures of one size")
        if other.kind != first.kind:
            raise ValueError(f"{other.path}: is {other.kind}, and {first.path} is {first.kind}: give files of one kind")
        names = [one.shooting.camera for one in (first, other)]
        if all(names) and names[0] != names[1]:
            raise ValueError(
                f"{other.path}: was taken with {names[1]}, and {first.path} with {names[0]}: use one camera"
            )
        curves = [one.transfer and one.transfer.name for one in (first, other)]
        spaces = [str(one.primaries) for one in (first, other)]
        if curves[0] != curves[1] or spaces[0] != spaces[1]:
            raise ValueError(f"{other.path}: has another colour profile than {first.path}: export all alike")
        modes = [one.shooting.white_balance for one in (first, other)]
        if modes[0] != modes[1]:
            raise ValueError(
                f"{other.path}: its white balance is {modes[1] or 'not said'} and that of {first.path} "
                f"{modes[0] or 'not said'} (EXIF): use one setting for all"
            )
    if first.shooting.white_balance == "auto" and first.integers:
        warn(f"{first.path}: its white balance is automatic (EXIF), which may differ between sets: set it by hand")


def check_shown(frames: Sequence[Frame]) -> None:
    """Raise ValueError for an exposure that holds no finite value, or is black or white altogether."""
    for frame in frames:
        highest = frame.codes.max() if frame.codes.dtype.kind == "u" else np.nanmax(frame.codes, initial=0)
        if not highest > 0:
            raise ValueError(f"{frame.path}: is black; leave it out")
        if frame.codes.dtype.kind == "u" and frame.codes.min() >= _WHITE * np.iinfo(frame.codes.dtype).max:
            raise ValueError(f"{frame.path}: is white throughout, clipped; leave it out, and take shorter exposures")


def check_order(frames: Sequence[Frame], samples: Samples, exposures: np.ndarray) -> None:
    """Raise ValueError where an exposure that is longer by its time is darker, or as bright."""
    for k in range(len(frames) - 1):
        if exposures[k + 1] < _CLEARLY * exposures[k]:
            continue
        dark, bright = samples.codes[k], samples.codes[k + 1]
        both = np.isfinite(dark) & np.isfinite(bright) & (dark > _BLACK)
        ratio = (
            np.median(bright[both] / dark[both]) if both.sum() >= _FEWEST else _mean(frames[k + 1]) / _mean(frames[k])
        )
        if ratio <= 1 + 0.1 * min(1.0, np.log2(exposures[k + 1] / exposures[k])) * (both.sum() >= _FEWEST):
            times, how = exposures[k + 1] / exposures[k], "as bright" if ratio > 0.97 else "darker"
            raise ValueError(
                f"{frames[k + 1].path}: has {times:.3g} times the exposure of {frames[k].path} by its time and is "
                f"{how}: are --times right, and in the order of the files?"
            )


def _mean(frame: Frame) -> float:
    return float(np.nanmean(frame.codes[::5, ::5].astype(np.float32)))


def warn_of(frames: Sequence[Frame], chosen: Chosen) -> None:
    """Warn where frames do not agree with their exposures, in brightness, in colour, or along the curve."""
    found, power = chosen.found, _power(chosen.curve)
    if not 1 / _STEEPEST < power < _STEEPEST:
        warn(
            f"{frames[0].path} and others: by these times the response is about sRGB's to the power {power:.2f}, as no "
            f"camera's is: their ratios are wrong, perhaps to the power {power:.2f}; are --times right?"
        )
    worst = int(np.argmax(np.abs(found.by_frame)))
    amount = np.expm1(found.by_frame[worst])
    alone = (np.abs(found.by_frame) > _BRIGHTNESS).sum() == 1 or chosen.curve.known is None
    if abs(amount) > _BRIGHTNESS and alone:
        how = "brighter" if amount > 0 else "darker"
        warn(
            f"{frames[worst].path}: is {abs(amount):.0%} {how} than its exposure says: its time is wrong, or the light "
            "changed, or the response is another"
        )
    if found.by_colour > _COLOUR:
        warn(
            f"{frames[worst].path} and others: colours differ by {found.by_colour:.0%} between exposures: was the "
            "white balance automatic? Set it by hand"
        )
    if (
        np.isfinite(found.misfit)
        and max(found.misfit, found.bias) > _APART
        and not (abs(amount) > _BRIGHTNESS and alone)
    ):
        cure = "" if chosen.curve.known is None else "; leave --response and --like out to have it estimated"
        warn(
            f"{frames[0].path} and others: under this response {found}: the scene moved, or the response is "
            f"another{cure}"
        )


def _power(curve: Curve) -> float:
    """Of sRGB's response that is nearest to an estimated one; 1 for others."""
    if curve.known is not None:
        return 1.0
    codes = np.linspace(0.1, 0.9, 33)
    wanted = np.log(SRGB.decode(codes))
    return float(np.mean([np.polyfit(wanted, np.log(curve.decode(codes, channel)), 1)[0] for channel in range(3)]))
