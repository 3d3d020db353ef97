"""What `torchbrdf fit --align` finds, and what is written of it."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from torchbrdf.arguments import warn
from torchbrdf.brdf import MaterialLibrary
from torchbrdf.commands._sight import Sight
from torchbrdf.files import writing
from torchbrdf.images import ColourSpace
from torchbrdf.light import LightProbe
from torchbrdf.photograph import Observation
from torchbrdf.transport import BasisImages

if TYPE_CHECKING:  # a photograph that is not aligned need not wait for it
    from torchbrdf.alignment import Alignment, FoundSilhouette, LampRadiance


def aligned(options: argparse.Namespace, sight: Sight, probe: LightProbe, library: MaterialLibrary) -> Alignment:
    """The alignment that the options ask for; of a ball with its silhouette, in the whole photograph."""
    from torchbrdf.alignment import align

    guess = None if options.keep_silhouette else sight.silhouette
    seen = (
        (sight.observation.image, sight.observation.mask)
        if guess is None
        else (sight.photograph.image, sight.photograph.usable)
    )
    return align(
        seen[0],
        probe,
        sight.view,
        library,
        mask=seen[1],
        silhouette=guess or False,
        search=options.search or "near",
        blur=options.blur,
        exposure=options.exposure,
        white_balance=options.white_balance,
        progress=True,
    )


def seen_anew(sight: Sight, found: Alignment) -> Sight:
    """The photograph with the silhouette that was found, where one was looked for."""
    if found.ball is None or not found.ball.moved:
        return sight
    ball = found.ball
    return replace(
        sight,
        observation=ball.observation,
        view=ball.view,
        silhouette=ball.silhouette,
        found=f"{ball.silhouette}, as the alignment found it",
    )


def warn_of_lamps(probe: LightProbe, found: Alignment) -> None:
    """Say how well the radiance of clipped lamps of the probe is told."""
    if found.lamp is None:
        return
    if found.lamp.clipped and found.lamp.confident:
        worst = float(found.lamp.std.max())
        warn(
            f"{probe.name}: {found.lamp.lamps.about}: their radiance, by one factor, is that which the photograph "
            f"tells, to {worst:.0%}, and the BRDF is off where it is; a shorter exposure of the probe shows it"
        )
    elif not found.lamp.confident and (found.lamp.clipped or found.lamp.lamps.certain):
        warn(
            f"{probe.name}: {found.lamp.lamps.about}: this photograph cannot tell their radiance for sure, and a lamp "
            "that is off spoils what it lights; take a shorter exposure of the probe, or photograph a side that they "
            "light"
        )


def warn_of_turn(found: Alignment) -> None:
    """Say where the probe is turned by more than the photograph tells for sure."""
    if found.angle and not found.confident:
        warn(
            f"the light probe is turned by {found.angle:.1f} degrees, +- {found.uncertainty:.1f} about the least "
            "certain axis, more than this photograph can tell for sure; --search full looks all around the vertical "
            "axis, too"
        )


def warn_of_blur(found: Alignment) -> None:
    """Say that a blur that was found may be none of the light's."""
    if found.blur:
        warn(
            f"the light probe is blurred by {found.blur:.2f} degrees, which explains the photograph better; so may a "
            "blur explain a material that is rougher than the library's or has flakes: compare with the fit without "
            "--blur"
        )


def divided(observation: Observation, found: Alignment) -> Observation:
    """The observation divided by its exposure, where that was found."""
    if found.exposure is None:
        return observation
    return replace(observation, image=observation.image / found.exposure.factors.to(observation.image)[:, None, None])


def basis_of(found: Alignment) -> BasisImages:
    """The basis images, said to be of the aligned probe that is written beside them."""
    return replace(found.basis, probe=found.probe.fingerprint)


def silhouette_record(ball: FoundSilhouette) -> dict[str, object]:
    """What alignment.json holds of it: places in pixels of the photograph."""
    x, y, radius = ball.silhouette.circle
    return {
        "x": x,
        "y": y,
        "radius": radius,
        "standard_deviations": ball.std,
        "moved": ball.moved,
        "log_gain": ball.log_gain,
    }


def write(record_path: Path, probe_path: Path, found: Alignment, primaries: ColourSpace) -> None:
    """Write alignment.json and the aligned probe, in this colour space."""
    record = {
        "turned": found.turned,
        "rotation": found.rotation.tolist(),
        "degrees": found.angle,
        "standard_deviation_degrees": found.uncertainty,
        "confident": found.confident,
        "log_odds": found.log_odds,
        "blur_degrees": found.blur,
        "silhouette": None if found.ball is None else silhouette_record(found.ball),
        "exposure": None if found.exposure is None else found.exposure.factors.tolist(),
        "exposure_log_std": None if found.exposure is None else found.exposure.std.tolist(),
        "lamp": None if found.lamp is None else _lamp_record(found.lamp),
    }
    with writing(record_path) as path:
        path.write_text(json.dumps(record, indent=1) + "\n")
    found.probe.save(probe_path, primaries)


def _lamp_record(lamp: LampRadiance) -> dict[str, object]:
    return {
        "texels": lamp.lamps.about,
        "clipped": lamp.clipped,
        "factors": lamp.factors.tolist(),
        "log_std": lamp.std.tolist(),
        "log_odds": None if lamp.lamps.unknown else lamp.log_odds,
        "confident": lamp.confident,
    }
