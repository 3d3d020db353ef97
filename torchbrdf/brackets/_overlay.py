"""How the frames of a bracket lie over one of them."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from torchbrdf.brackets.frames import Frame
from torchbrdf.brackets.registration import Motion, find_motion

_SLIGHT, _USUALLY = 1.0, 0.25
"""Pixels at the corners, at most and in the median: a tripod's, of which dark frames tell more than there was."""


def overlay(frames: Sequence[Frame], clip: np.ndarray, reference: int, still: bool) -> dict[int, Motion]:
    """From the reference to every frame that can be laid over it, by neighbours in exposure, in their order.

    frames  in order of exposure
    clip    (3,)  from which value on codes are clipped
    still   take all as they are
    Warns of frames with too little in common with the others to tell, which are left out. Where the others hardly moved
    they lie like their neighbour instead: the shortest may show nothing but a lamp, which must not be lost. Raises
    ValueError where frames do not show the same, or too few are left.
    """
    if still:
        return dict.fromkeys(range(len(frames)), Motion())
    found = {reference: Motion()}
    for outward in (range(reference + 1, len(frames)), range(reference - 1, -1, -1)):
        near, tones = reference, _tones(frames[reference], clip[1])
        for k in outward:
            own = _tones(frames[k], clip[1])
            step = _step(frames, near, k, tones, own)
            if step is not None:
                found[k] = step.after(found[near])
                near, tones = k, own
    unknown = [k for k in range(len(frames)) if k not in found]
    size = (frames[0].codes.shape[0], frames[0].codes.shape[1])
    moved = [motion.pixels(size) for motion in found.values()]
    if unknown and max(moved) < _SLIGHT and np.median(moved) < _USUALLY and len(found) > 1:
        known = list(found)
        found |= {k: found[min(known, key=lambda near: abs(near - k))] for k in unknown}
        unknown = []
    if len(found) < 2:
        raise ValueError(
            f"{frames[reference].path}: has too little in common with the other exposures to be laid over them; take "
            "exposures closer together, or give --still where the camera did not move; or they are not of one scene"
        )
    for k in unknown:
        message = "has too little in common with the others to be laid over them, which moved: left out"
        warnings.warn(f"{frames[k].path}: {message}", UserWarning, stacklevel=3)
    return dict(sorted(found.items()))


def _step(frames: Sequence[Frame], near: int, k: int, tones: np.ndarray, own: np.ndarray) -> Motion | None:
    """From one frame to another."""
    try:
        if near < k:
            return find_motion(tones, own)
        back = find_motion(own, tones)
        return back and back.inverse()
    except LookupError:
        raise ValueError(
            f"{frames[k].path}: cannot be laid over {frames[near].path}: it moved too far, or shows something else; "
            "leave it out, or give --still where the camera did not move; or they are not of one scene"
        ) from None


def _tones(frame: Frame, clip: float) -> np.ndarray:
    """(H, W) float32 green in [0, 1] with clipping at 1, on a curve like sRGB's so that dark tones count."""
    green = frame.codes[..., 1].astype(np.float32)
    if frame.integers:
        return green / np.float32(frame.full_scale * clip)
    scale = clip * frame.full_scale if np.isfinite(clip) else np.nanquantile(green, 0.999)
    return np.asarray(np.clip(np.nan_to_num(green) / scale, 0, 1) ** (1 / 2.2), dtype=np.float32)
