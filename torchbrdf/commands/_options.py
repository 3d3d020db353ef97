"""Options that several commands share."""

import argparse
from pathlib import Path
from typing import get_args

from torchbrdf.estimation import CONSTRAINTS, DEFAULT_PENALTY, Penalty
from torchbrdf.light import Layout

LAYOUTS = get_args(Layout)
STD = "brdf_std.binary"
"""The standard deviation of f_r in every cell, as a MERL table, in a folder that `torchbrdf fit` writes."""

_PENALTY_HELP = (
    f'"auto" weighs the priors by their evidence; "paper" (0.5) or a number >= 0; default: {DEFAULT_PENALTY}'
)
_CONSTRAINT_HELP = (
    "nonnegative weights; convex: they also sum to 1; energy: a BRDF >= 0 that reflects no more than it gets"
)


def add_output(parser: argparse.ArgumentParser, text: str, default: Path | None = None) -> None:
    """`-o`, required where there is no default."""
    parser.add_argument("-o", "--output", type=Path, required=default is None, default=default, help=text)


def add_light(parser: argparse.ArgumentParser, required: bool = True, default: str | None = None) -> None:
    """`--probe` and how to read it."""
    text = 'light probe, .exr or .hdr; "default" for the embedded one'
    parser.add_argument("--probe", required=required and default is None, default=default, help=text)
    parser.add_argument("--probe-layout", choices=LAYOUTS, default="latlong", help="default: latlong")
    parser.add_argument("--repair-probe", action="store_true", help="fill NaN and infinite texels of the probe")


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
        help="sphere (default); a mesh, .ply, .obj, .glb or .gltf; or a normal map, X Y Z in R G B, .exr or .png",
    )
    group.add_argument("--fov", type=float, metavar="DEG", help="field of view; default: orthographic")
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
    parser.add_argument("--mask", type=Path, help="image that is white where the shape may be used")
    text = "silhouette in pixels; default: from the mask"
    parser.add_argument("--circle", type=float, nargs=3, metavar=("X", "Y", "R"), help=text)
    add_library(parser)
    parser.add_argument(
        "--penalty", type=penalty, default=DEFAULT_PENALTY, metavar="auto|paper|X", help=_PENALTY_HELP
    )
    parser.add_argument("--constraint", choices=CONSTRAINTS, help=_CONSTRAINT_HELP + "; default: none")
    parser.add_argument("--robust", action="store_true", help="leave out pixels that do not fit, such as dead ones")
    parser.add_argument("--size", type=int, help="resample to N x N pixels; default: its own, at most 128")
    parser.add_argument("--allow-ldr", action="store_true", help="accept an 8-bit photograph, taken as gamma 2.2")


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
