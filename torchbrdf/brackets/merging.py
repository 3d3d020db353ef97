"""The weighted mean of what exposures say of radiance, and which pixels none of them holds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from torchbrdf.brackets.frames import Frame
from torchbrdf.brackets.registration import Motion
from torchbrdf.brackets.response import Curve

_ROLL = 0.85
"""Of the clipping code: from here on weights fall, so that noise does not choose who is clipped."""
_BLACK_STEPS = 8.0
"""Codes over which weights rise from black."""
_LEAST = 1e-3
"""Weight of a code of 0 in a pixel that other channels show: it counts where no other frame says more."""
_SEEN_STEPS = 1.5
"""A pixel whose brightest channel is below shows nothing."""
_SHOT = 2e-4
"""Variance of photons over the linear value: 5000 electrons fill a pixel. Only its ratio to that of codes counts."""
_CODE_NOISE = 1.0
"""Deviation of a code, in steps."""


@dataclass(frozen=True)
class Radiance:
    """Linear values over exposure, (H, W, 3) float32: NaN in the pixels counted here.

    lost        (H, W) bool: too bright for the shortest frame, and so for all
    bright      clipped in every frame that shows them, or beside such pixels
    dark        black in every frame
    between     clipped in some frames and black in all others
    unrecorded  NaN in every frame
    """

    values: np.ndarray
    lost: np.ndarray
    bright: int
    dark: int
    between: int
    unrecorded: int


def merged(
    frames: Sequence[Frame], motions: Sequence[Motion], exposures: np.ndarray, curve: Curve, clip: np.ndarray
) -> Radiance:
    """Each frame's linear value over its exposure, weighted with the exposure.

    That is the best linear estimate where photons are the noise [HDF10], and nearly so for codes of 8 bits on a curve
    like sRGB's; codes where the curve is flatter count less.
    motions    from the reference to each frame
    exposures  (F,)
    clip       (3,)  from which value on codes are clipped
    """
    import cv2

    size = (frames[0].codes.shape[0], frames[0].codes.shape[1])
    numerator = np.zeros((3, *size), dtype=np.float32)
    denominator = np.zeros_like(numerator)
    shown, clipped, lost = (np.zeros(size, dtype=bool) for _ in range(3))
    for frame, motion, exposure in zip(frames, motions, exposures.astype(np.float32), strict=True):
        moved = _Moved(motion, size)
        open_share, bright = _unclipped(frame, clip)
        if frame is frames[0]:
            lost = moved(bright) > 0.5
        if margin := 2 if not motion.still(size) else int(frame.kind.endswith("JPEG")):
            bright = cv2.dilate(bright, np.ones((2 * margin + 1, 2 * margin + 1), np.uint8))
            open_share[bright > 0] = 0  # what lies around clipped pixels is not trusted either
        open_share = moved(open_share)
        clipped |= moved(bright) > 0
        seen = frame.codes.max(axis=2) > _SEEN_STEPS * frame.step * frame.full_scale
        shown |= (open_share > 0) & (moved(seen.astype(np.float32)) > 0.5)
        for k in range(3):
            linear, trust = _channel(frame, curve, k)
            weight = exposure * open_share * moved(trust)
            denominator[k] += weight
            numerator[k] += np.where(weight > 0, weight * moved(linear, values=True), 0) / exposure
    held = (denominator > 0).all(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        values = np.where(held & shown, numerator / denominator, np.nan).transpose(1, 2, 0)
    unseen = held & ~shown
    counts = (int(one.sum()) for one in (~held & clipped, unseen & ~clipped, unseen & clipped, ~held & ~clipped))
    return Radiance(np.ascontiguousarray(values), lost & ~held, *counts)


class _Moved:
    """Planes (H, W) float32 of a frame as the reference sees them; beside the frame 0."""

    def __init__(self, motion: Motion, size: tuple[int, int]) -> None:
        self.still = motion.still(size)
        self.matrix, self.size = motion.matrix(size), (size[1], size[0])

    def __call__(self, plane: np.ndarray, values: bool = False) -> np.ndarray:
        """A plane of weights, or one of values, which goes on as it ends."""
        import cv2

        if self.still:
            return plane
        border = cv2.BORDER_REPLICATE if values else cv2.BORDER_CONSTANT

        def warped(how: int) -> np.ndarray:
            flags = how | cv2.WARP_INVERSE_MAP
            return cv2.warpAffine(plane, self.matrix, self.size, flags=flags, borderMode=border)

        linear = warped(cv2.INTER_LINEAR)
        if not values:
            return linear
        cubic = warped(cv2.INTER_CUBIC)
        return np.where(cubic < 0, linear, cubic)  # beside a lamp cubics ring


def _unclipped(frame: Frame, clip: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) float32 each: from 1 to 0 towards clipping in any channel; and 1 where it is reached."""
    share = np.ones(frame.codes.shape[:2], dtype=np.float32)
    for k in range(3):
        np.minimum(share, _of_codes(frame, k, partial(_falling, clip=float(clip[k]))), out=share)
    bright = np.where((share > 0) | np.isnan(frame.codes).any(axis=2), np.float32(0), np.float32(1))
    return share, bright


def _falling(codes: np.ndarray, clip: float) -> np.ndarray:
    if not np.isfinite(clip):
        return np.isfinite(codes).astype(np.float32)
    share = np.clip((clip - codes) / ((1 - _ROLL) * clip), 0, 1)
    return np.where(np.isfinite(codes), share, 0)


def _channel(frame: Frame, curve: Curve, k: int) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) float32 each: linear values, and how far codes are to be trusted."""
    step = frame.step

    def trust(codes: np.ndarray) -> np.ndarray:
        if not step:
            return np.ones_like(codes)
        linear = np.maximum(curve.decode(codes, k), 1e-9)
        noise = (_CODE_NOISE * step * curve.slope(codes, k)) ** 2
        rising = np.clip(codes / (_BLACK_STEPS * step), 0, 1)
        return np.maximum(rising * _SHOT * linear / (_SHOT * linear + noise), _LEAST)

    values = _of_codes(frame, k, lambda codes: curve.decode(codes, k))
    return np.nan_to_num(values, copy=False), _of_codes(frame, k, trust)


def _of_codes(frame: Frame, k: int, function: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """A function of a channel's codes in [0, 1]: by a table where they are integers."""
    codes: np.ndarray = frame.codes[..., k]
    if codes.dtype.kind != "u":
        return np.asarray(function(codes / frame.full_scale), dtype=np.float32)
    every = np.arange(np.iinfo(codes.dtype).max + 1) / frame.full_scale
    table: np.ndarray = np.asarray(function(np.minimum(every, 1)), dtype=np.float32)
    return table[codes]
