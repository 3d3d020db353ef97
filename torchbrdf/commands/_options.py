"""Options that several commands share."""

import argparse
from pathlib import Path
from typing import get_args

from torchbrdf.estimation import CONSTRAINTS, DEFAULT_PENALTY, Penalty
from torchbrdf.images import DEFAULT_SPACE, ColourSpace, Encoding
from torchbrdf.light import Layout, Rows

STD = "brdf_std.binary"
"""The standard deviation of f_r in every cell, as a MERL table, in a folder that `torchbrdf fit` writes."""

TABLE_HELP = "MERL table, .binary, or a folder that `fit` wrote"

_PENALTY_HELP = (
    f'"auto" weighs the priors by their evidence; "paper" (0.5) or a number >= 0; default: {DEFAULT_PENALTY}'
)
_CONSTRAINT_HELP = (
    "nonnegative weights; convex: they also sum to 1; energy: a BRDF >= 0 that reflects no more than it gets"
)


def add_output(parser: argparse.ArgumentParser, text: str, default: Path | None = None) -> None:
    """`-o`, required where there is no default."""
    parser.add_argument("-o", "--output", type=Path, required=default is None, default=default, help=text)


def add_strict(parser: argparse.ArgumentParser) -> None:
    """`--strict`, which the command line looks at after the command."""
    parser.add_argument("--strict", action="store_true", help="exit with status 3 where there was a warning")


def add_table(parser: argparse.ArgumentParser) -> None:
    """The table that a command is about; see `_inputs.open_table`."""
    parser.add_argument("brdf", type=Path, metavar="BRDF", help=TABLE_HELP)


def add_light(parser: argparse.ArgumentParser, required: bool = True, default: str | None = None) -> None:
    """`--probe` and how to read it."""
    text = 'light probe, .exr or .hdr; "default" for the embedded one'
    parser.add_argument("--probe", required=required and default is None, default=default, help=text)
    add_reading(parser, "probe")
    text = "linear RGB of photograph, light and BRDF, to which files are converted; default: %(default)s"
    parser.add_argument("--primaries", choices=get_args(ColourSpace), default=DEFAULT_SPACE, help=text)
    parser.add_argument("--repair-probe", action="store_true", help="fill NaN texels of the probe, and say how many")


def add_reading(parser: argparse.ArgumentParser, light: str) -> None:
    """How to read the file of `--probe`, or of another option for a light."""
    text = "of the picture; default: latlong"
    parser.add_argument(f"--{light}-layout", choices=get_args(Layout), default="latlong", help=text)
    text = (
        "a lat-long's rows lie at pixel centres (most programs) or run from pole to pole (Mitsuba); default: "
        "what the file says, else centres"
    )
    parser.add_argument(f"--{light}-rows", choices=get_args(Rows), help=text)
    text = "where the disc of a mirror ball or an angular map is, in pixels; default: a tight square crop"
    parser.add_argument(f"--{light}-circle", type=float, nargs=3, metavar=("X", "Y", "R"), help=text)
    text = "image that is white where such a disc may be used"
    parser.add_argument(f"--{light}-mask", type=Path, metavar="FILE", help=text)
    if light == "probe":
        text = "share of the light that the mirror ball reflects, one number or R G B; default: all"
        parser.add_argument("--mirror-reflectance", type=float, nargs="+", metavar="R", help=text)


def add_library(parser: argparse.ArgumentParser) -> None:
    """`--library`."""
    parser.add_argument("--library", type=Path, help="folder of MERL *.binary files; default: the embedded library")


def add_shape(parser: argparse.ArgumentParser) -> None:
    """`--view` and the camera before it."""
    group = parser.add_argument_group("the shape and its camera", "axes and units are the mesh's, axes the probe's")
    group.add_argument(
        "--view",
        default="sphere",
        metavar="sphere|NORMALS|MESH",
        help="sphere (default); a mesh, .ply or .obj; or a normal map, .exr, X Y Z in R G B",
    )
    text = "horizontal field of view of the whole picture, as given; default: orthographic"
    group.add_argument("--fov", type=float, metavar="DEG", help=text)
    for name, text in (
        ("toward", "from the target towards the camera; default: 0 0 1"),
        ("up", "what is up in the image; default: 0 1 0"),
        ("target", "what the camera looks at; default: the middle of the mesh"),
    ):
        group.add_argument(f"--{name}", type=float, nargs=3, metavar=("X", "Y", "Z"), help=text)
    group.add_argument("--width", type=float, help="shown at the target; default: the mesh's bounding sphere")
    group.add_argument("--no-shadows", action="store_true", help="light the mesh as if it cast no shadows")


def add_estimation(parser: argparse.ArgumentParser) -> None:
    """What is used of a photograph, and how it is explained."""
    text = "image that is white where the shape may be used; default: the photograph's alpha, else all of it"
    parser.add_argument("--mask", type=Path, help=text)
    parser.add_argument("--invert-mask", action="store_true", help="the mask is white around the shape")
    text = "silhouette in pixels; default: from the mask, else as large as the photograph"
    parser.add_argument("--circle", type=float, nargs=3, metavar=("X", "Y", "R"), help=text)
    parser.add_argument("--layer", metavar="NAME", help="of a photograph that holds several pictures")
    add_library(parser)
    parser.add_argument(
        "--penalty", type=penalty, default=DEFAULT_PENALTY, metavar="auto|paper|X", help=_PENALTY_HELP
    )
    parser.add_argument("--constraint", choices=CONSTRAINTS, help=_CONSTRAINT_HELP + "; default: none")
    parser.add_argument("--robust", action="store_true", help="leave out pixels that do not fit, such as dead ones")
    parser.add_argument("--size", type=int, help="resample to N x N pixels; default: its own, at most 128")
    text = "accept a photograph of 8 or 16 bits, decoded as it says, else with gamma 2.2"
    parser.add_argument("--allow-ldr", action="store_true", help=text)
    text = "accept it, decoded so, whatever it says"
    parser.add_argument("--encoding", choices=get_args(Encoding), help=text)


def penalty(text: str) -> Penalty:
    """Parse `--penalty`."""
    if text == "auto":
        return "auto"
    if text == "paper":
        return "paper"
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f'must be "auto", "paper" or a number >= 0, got {text}')
    return value
