"""What `torchbrdf fit --align` finds, and what is written of it."""

import argparse
import json
from dataclasses import replace
from pathlib import Path

from torchbrdf.alignment import Alignment, align
from torchbrdf.brdf import MaterialLibrary
from torchbrdf.files import writing
from torchbrdf.images import ColourSpace
from torchbrdf.light import LightProbe
from torchbrdf.photograph import Observation
from torchbrdf.transport import BasisImages
from torchbrdf.view import View


def aligned(
    options: argparse.Namespace, observation: Observation, probe: LightProbe, view: View, library: MaterialLibrary
) -> Alignment:
    """The alignment that the options ask for."""
    return align(
        observation.image,
        probe,
        view,
        library,
        mask=observation.mask,
        search=options.search or "near",
        blur=options.blur,
        exposure=options.exposure,
        white_balance=options.white_balance,
        progress=True,
    )


def divided(observation: Observation, found: Alignment) -> Observation:
    """The observation divided by its exposure, where that was found."""
    if found.exposure is None:
        return observation
    return replace(observation, image=observation.image / found.exposure.factors.to(observation.image)[:, None, None])


def basis_of(found: Alignment) -> BasisImages:
    """The basis images, said to be of the aligned probe that is written beside them."""
    return replace(found.basis, probe=found.probe.fingerprint)


def write(folder: Path, found: Alignment, primaries: ColourSpace) -> None:
    """Write alignment.json and aligned_probe.exr, in this colour space, into a folder."""
    record = {
        "rotation": found.rotation.tolist(),
        "degrees": found.angle,
        "standard_deviation_degrees": found.uncertainty,
        "confident": found.confident,
        "log_odds": found.log_odds,
        "blur_degrees": found.blur,
        "exposure": None if found.exposure is None else found.exposure.factors.tolist(),
        "exposure_log_std": None if found.exposure is None else found.exposure.std.tolist(),
    }
    with writing(folder / "alignment.json") as path:
        path.write_text(json.dumps(record, indent=1) + "\n")
    found.probe.save(folder / "aligned_probe.exr", primaries)
