"""`torchbrdf merge`: exposures of one scene to one linear picture."""

import argparse
from pathlib import Path
from typing import get_args

from torchbrdf.brackets import Response
from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import add_output, add_strict, number
from torchbrdf.files import writing
from torchbrdf.images import ColourSpace

EXAMPLES = (
    "torchbrdf merge IMG_0001.CR2 IMG_0002.CR2 IMG_0003.CR2 -o ball.exr",
    "torchbrdf merge dark.jpg bright.jpg --times 1/250 1/15 --like ball.exr -o probe.exr",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which exposures, and what is known of the camera."""
    text = "exposures: .jpg, .png, .tif, .exr, or camera RAW with `pip install 'torchbrdf[raw]'`"
    parser.add_argument("images", type=Path, nargs="+", metavar="IMG", help=text)
    text = "exposure times in seconds, in the order of the files; default: what they say (EXIF)"
    parser.add_argument("--times", type=seconds, nargs="+", metavar="T", help=text)
    text = "what the camera made of radiance; default: what the files say where exposures agree under it, else estimate"
    parser.add_argument("--response", choices=get_args(Response), help=text)
    text = "picture merged before, by the same camera: its response, white balance of RAW, scale and primaries"
    parser.add_argument("--like", type=Path, metavar="FILE.exr", help=text)
    parser.add_argument("--still", action="store_true", help="the camera did not move: do not look for it")
    text = "linear RGB of the result; default: that of --like, else rec709"
    parser.add_argument("--primaries", choices=get_args(ColourSpace), help=text)
    add_strict(parser)
    add_output(
        parser,
        "X.exr: linear radiance; infinite where too bright for all exposures, NaN where else none holds it",
    )


def seconds(text: str) -> float:
    """Parse a time, also as cameras show it: 1/60."""
    above = number(0)
    numerator, slash, denominator = text.partition("/")
    return above(numerator) / above(denominator) if slash else above(text)


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Merge brackets, a scene at several exposures, into one linear HDR picture for `fit` and `--probe`."""
    from numpy import errstate

    from torchbrdf.brackets import merge
    from torchbrdf.images import write_image

    if options.output.suffix.lower() != ".exr":
        raise ValueError(
            f"{options.output}: a merged picture is an .exr file, which keeps what it was made with; name it X.exr"
        )
    with writing(options.output) as temporary, errstate(invalid="ignore", over="ignore"):  # of infinite pixels
        merged = merge(
            options.images,
            options.times,
            response=options.response,
            like=options.like,
            still=options.still,
            primaries=options.primaries,
        )
        write_image(temporary, merged.image, merged.attributes, primaries=merged.calibration.primaries)
    for line in merged.about:
        findings.line(line)
    findings.line(f"wrote {options.output}")
    findings.add(about=merged.about, primaries=merged.calibration.primaries)
    findings.add_files(options.output)
    return 0
