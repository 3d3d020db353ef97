"""What is said of a merged picture."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from math import degrees

from torchbrdf.brackets.frames import Frame
from torchbrdf.brackets.merging import Radiance
from torchbrdf.brackets.registration import Motion

_BRIGHT_SHARE, _DARK_SHARE, _BETWEEN_SHARE = 1e-4, 0.05, 0.01
"""Of the pixels: with more, a warning."""


def describe_motions(frames: Sequence[Frame], motions: Sequence[Motion], reference: int) -> str:
    """How the camera moved."""
    size = (frames[0].codes.shape[0], frames[0].codes.shape[1])
    moved = [motion for motion in motions if not motion.still(size)]
    if not moved:
        return f"the camera did not move, up to 0.1 pixels; {frames[reference].path} is best exposed"
    turn = max(degrees(abs(motion.turn_rad)) for motion in moved)
    far = max(motion.pixels(size) for motion in moved)
    by = f"moved by up to {far:.1f} pixels, turned by {turn:.2f} degrees"
    count = f"{len(moved)} exposure{'s' * (len(moved) > 1)}"
    return f"{count} laid over {frames[reference].path}: {by}"


def describe_missing(frames: Sequence[Frame], radiance: Radiance) -> str:
    """How many pixels no exposure holds, and why; warns where they are many."""
    count = frames[0].codes.shape[0] * frames[0].codes.shape[1]
    shortest, longest = frames[0].path, frames[-1].path
    parts = [
        (radiance.bright, _BRIGHT_SHARE, f"too bright for {shortest}, the shortest: add a shorter one"),
        (radiance.dark, _DARK_SHARE, f"too dark for {longest}, the longest: add a longer one"),
        (radiance.between, _BETWEEN_SHARE, "clipped in one exposure and black in the next: add one between"),
    ]
    for missing, share, why in parts:
        if missing > share * count:
            warnings.warn(f"{missing} of {count} pixels ({missing / count:.2%}) are {why}", UserWarning, stacklevel=4)
    total = sum(missing for missing, _, _ in parts) + radiance.unrecorded
    if not total:
        return f"all {count} pixels are held"
    lost = int(radiance.lost.sum())
    bright = f"{radiance.bright} too bright" + (f" ({lost} infinite, the others beside them)" if lost else "")
    told = f"{bright}, {radiance.dark} too dark, {radiance.between} between exposures"
    if radiance.unrecorded:
        told += f", {radiance.unrecorded} recorded by no file"
    return f"no exposure holds {total} of {count} pixels, which are {'infinite or ' if lost else ''}NaN: {told}"
