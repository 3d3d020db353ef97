"""`torchbrdf fit --align`: options, and what is written of an alignment."""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import get_args

from torchbrdf.alignment import Alignment, Range, align
from torchbrdf.basis_images import BasisImages
from torchbrdf.files import writing
from torchbrdf.images import write_image
from torchbrdf.library import MaterialLibrary
from torchbrdf.photograph import Observation
from torchbrdf.probe import LightProbe
from torchbrdf.view import View

_ONLY_WITH_ALIGN = ("search", "blur", "exposure", "white_balance")


def add_options(parser: argparse.ArgumentParser) -> None:
    """`--align` and what belongs to it."""
    group = parser.add_argument_group("alignment of the light probe with the photograph")
    group.add_argument("--align", action="store_true", help="find the rotation of the probe")
    text = "near: within about 20 degrees (default); full: also any turn about the vertical axis"
    group.add_argument("--search", choices=get_args(Range), help=text)
    group.add_argument("--blur", action="store_true", help="find a blur of the probe, too")
    text = "find a factor of the photograph, too, and divide by it; rarely certain to better than 50 %%"
    group.add_argument("--exposure", action="store_true", help=text)
    group.add_argument("--white-balance", action="store_true", help="the same for each colour channel")


def check(options: argparse.Namespace) -> None:
    """Raise ValueError for options that do not go together."""
    for name in _ONLY_WITH_ALIGN:
        if getattr(options, name) and not options.align:
            raise ValueError(f"--{name.replace('_', '-')} is a part of the alignment: give --align, too")
    if options.align and options.basis is not None:
        raise ValueError("--basis holds images under the probe as it is, and --align turns it: leave one of them out")


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


def write(folder: Path, found: Alignment) -> None:
    """Write alignment.json and aligned_probe.exr into a folder."""
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
    write_image(folder / "aligned_probe.exr", found.probe.radiance)
