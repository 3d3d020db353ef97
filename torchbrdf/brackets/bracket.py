"""From files of a bracket to one picture."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchbrdf.brackets._changes import warn_of_changes
from torchbrdf.brackets._checks import check_order, check_same, check_shown, warn_of
from torchbrdf.brackets._choice import Chosen, choose
from torchbrdf.brackets._overlay import overlay
from torchbrdf.brackets._words import describe_missing, describe_motions
from torchbrdf.brackets.calibration import ATTRIBUTE, Calibration
from torchbrdf.brackets.exposures import Exposures
from torchbrdf.brackets.frames import Frame, clip_levels, open_frame
from torchbrdf.brackets.merging import Radiance, merged
from torchbrdf.brackets.registration import Motion
from torchbrdf.brackets.samples import Samples
from torchbrdf.brackets.settings import Response
from torchbrdf.files import existing_file
from torchbrdf.images import DEFAULT_SPACE, SPACES, ColourSpace, conversion, read_shooting


@dataclass(frozen=True)
class Merged:
    """A picture of radiance, and what was found on the way.

    image        (3, H, W) float32  linear radiance; where no exposure holds it, infinite if too bright, else NaN
    calibration  what another set must be merged with to have the same scale
    attributes   what `write_image` keeps of it in an .exr file: the calibration, and how the photograph was taken
    about        for people: lines
    """

    image: Tensor
    calibration: Calibration
    attributes: dict[str, str | float]
    about: tuple[str, ...]


def merge(
    paths: Sequence[str | os.PathLike[str]],
    times: Sequence[float] | None = None,
    *,
    response: Response | None = None,
    like: str | os.PathLike[str] | None = None,
    still: bool = False,
    primaries: ColourSpace | None = None,
) -> Merged:
    """Merge exposures of one scene by one camera.

    paths      two or more files, in any order: JPEG, PNG, TIFF, OpenEXR, or camera RAW (with rawpy)
    times      exposure times in seconds above 0, in the order of the files; None for those that the files say (EXIF)
    response   what the camera made of radiance; None for what the files say where their exposures agree under it, else
               estimated
    like       a picture merged before, by the same camera: its response, white balance of camera RAW, and primaries
    still      the camera did not move: do not look for it
    primaries  of the result; None for those of `like`, else Rec. 709
    returns    radiance is the linear value, 1 for the highest code, over t ISO / (100 N^2), of which only is counted
               what the files say, so that sets of the same camera have one scale
    Warns of what harms the result but does not forbid it. Raises FileNotFoundError; ValueError for files that are no
    bracket.
    """
    files = [Path(path) for path in paths]
    if len(files) < 2:
        for path in files:
            existing_file(path, "an exposure of the bracket")
        raise ValueError(f"merge needs two exposures or more, got {len(files)}: give all files of the bracket")
    known = None if like is None else Calibration.read(Path(like))
    exposures = Exposures.of(files, [read_shooting(path) for path in files], times)
    order = np.argsort(exposures.said, kind="stable")
    frames = [open_frame(files[i]) for i in order]
    exposures = exposures.of_frames(order)
    check_same(frames)
    check_shown(frames)
    clip = clip_levels(frames)
    reference = _reference(frames)
    kept = overlay(frames, clip, reference, still)
    frames, motions = [frames[k] for k in kept], list(kept.values())
    exposures, reference = exposures.of_frames(list(kept)), list(kept).index(reference)
    samples = Samples.of(frames, motions, clip)
    check_order(frames, samples, exposures.said)
    chosen = choose(frames, samples, exposures, response, known, like)
    warn_of(frames, chosen)
    warn_of_changes(frames, samples, chosen)
    radiance = merged(frames, motions, chosen.exposures, chosen.curve, clip)
    return _result(frames, motions, reference, radiance, chosen, exposures.unit, known, primaries)


def _reference(frames: Sequence[Frame]) -> int:
    """The frame that shows most between black and clipping."""
    shares = []
    for frame in frames:
        codes = frame.codes[::7, ::7].max(axis=2) / frame.full_scale
        low, high = (0.1, 0.9) if frame.integers else (0.01, 0.9)
        shares.append(float(((codes > low) & (codes < high)).mean()))
    return int(np.argmax(shares))


def _result(
    frames: Sequence[Frame],
    motions: Sequence[Motion],
    reference: int,
    radiance: Radiance,
    chosen: Chosen,
    unit: str,
    known: Calibration | None,
    primaries: ColourSpace | None,
) -> Merged:
    values, first = radiance.values, frames[reference]
    target = primaries or (known.primaries if known else DEFAULT_SPACE)
    development = (known.development if known else None) or first.development
    source = SPACES[DEFAULT_SPACE] if first.development else first.primaries or SPACES[DEFAULT_SPACE]
    if first.development is not None and development is not None:
        values = development(values)
    if not source.agrees(SPACES[target]):
        values = values @ conversion(source, SPACES[target]).T.astype(np.float32)
    values = np.where(radiance.lost[..., None], np.float32(np.inf), values)
    calibration = Calibration(
        chosen.curve, chosen.stops, unit, target, first.shooting.camera, first.kind, first.development and development
    )
    size = (values.shape[0], values.shape[1])
    taken = replace(first.shooting, time_s=None, size=first.shooting.size or size).attributes()
    about = (
        f"{len(frames)} exposures over a range of {chosen.exposures[-1] / chosen.exposures[0]:.4g}; {chosen.about}",
        f"radiance is the linear value, 1 for the highest code, times {unit}",
        describe_motions(frames, motions, reference),
        describe_missing(frames, radiance),
    )
    image = torch.from_numpy(np.ascontiguousarray(values.transpose(2, 0, 1), dtype=np.float32))
    return Merged(image, calibration, {**taken, ATTRIBUTE: calibration.text()}, about)
