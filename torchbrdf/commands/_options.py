"""Options that several commands share."""

import argparse
from collections.abc import Callable
from math import isfinite
from pathlib import Path
from typing import Any, get_args

from torchbrdf.brdf import EMBEDDED, TABLE_SUFFIXES
from torchbrdf.estimation import CONSTRAINTS, DEFAULT_PENALTY, Penalty
from torchbrdf.images import DEFAULT_SPACE, ColourSpace, Encoding
from torchbrdf.light import Layout, Rows

TABLE_HELP = "MERL table, .binary; measured material of the RGL database, .bsdf; or a folder that `fit` wrote"

LIBRARY_HELP = (
    f"folder of measured tables ({', '.join(TABLE_SUFFIXES)}), such a file, a folder that `fit` wrote or of such "
    'folders, or "default", the embedded library'
)

LARGEST_SIZE = 8192
"""Pixels along a side that are believed to be meant."""

_LEAST_RADIUS = 1.5
_MOST_SAMPLES = 10**7
_FEWEST_SAMPLES = 2

_PENALTY_HELP = (
    f'"auto" weighs the priors by their evidence; "paper" (0.5) or a number >= 0; default: {DEFAULT_PENALTY}'
)
_CONSTRAINT_HELP = (
    "nonnegative weights; convex: they also sum to 1; energy: a BRDF >= 0 that reflects no more than it gets; lobes: "
    "highlights without rings and holes; default: lobes, with a fixed penalty none"
)


def add_output(parser: argparse.ArgumentParser, text: str, default: Path | None = None) -> None:
    """`-o`, required where there is no default."""
    parser.add_argument("-o", "--output", type=Path, required=default is None, default=default, help=text)


def add_strict(parser: argparse.ArgumentParser) -> None:
    """`--strict`, which the command line looks at after the command."""
    parser.add_argument("--strict", action="store_true", help="exit with status 3 where there was a warning")


def whole_number(least: int, most: int | None = None) -> Callable[[str], int]:
    """A parser of whole numbers from `least` to `most`."""
    limits = f"from {least} to {most}" if most is not None else f"of at least {least}"

    def parse(text: str) -> int:
        if not (text.isdecimal() and int(text) >= least and (most is None or int(text) <= most)):
            raise argparse.ArgumentTypeError(f"must be a whole number {limits}, got {text}")
        return int(text)

    return parse


def number(above: float | None = None, below: float | None = None) -> Callable[[str], float]:
    """A parser of finite numbers between two others, which are not meant."""
    limits = "" if above is None else f" above {above:g}" if below is None else f" between {above:g} and {below:g}"

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not (isfinite(value) and (above is None or value > above) and (below is None or value < below)):
            raise argparse.ArgumentTypeError(f"must be a finite number{limits}, got {text}")
        return value

    return parse


def add_size(parser: argparse.ArgumentParser, default: int | None, text: str) -> None:
    """`--size`, of a picture that holds a sphere."""
    parser.add_argument("--size", type=whole_number(3, LARGEST_SIZE), default=default, metavar="N", help=text)


def add_samples(parser: argparse.ArgumentParser, default: int | None, text: str) -> None:
    """`--samples` a pixel; a text whose default is None says what that means."""
    kind, known = whole_number(_FEWEST_SAMPLES, _MOST_SAMPLES), "" if default is None else f"; default: {default}"
    parser.add_argument("--samples", type=kind, default=default, metavar="N", help=f"{text}{known}")


class _Direction(argparse.Action):
    """Three numbers that are not all 0."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, *_: object) -> None:
        if not any(values):
            raise argparse.ArgumentError(self, "must not be 0 0 0, which is no direction")
        setattr(namespace, self.dest, values)


class _Circle(argparse.Action):
    """X, Y and a radius that holds pixels."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, *_: object) -> None:
        if values[2] < _LEAST_RADIUS:
            raise argparse.ArgumentError(self, f"the radius must be at least {_LEAST_RADIUS} pixels, got {values[2]:g}")
        setattr(namespace, self.dest, values)


def add_exposure(parser: argparse.ArgumentParser) -> None:
    """`--exposure` of a picture to look at."""
    text = "factor on the radiance in a .png or .jpg; default: the 99th percentile of the picture becomes white"
    parser.add_argument("--exposure", type=number(0), metavar="X", help=text)


def inputs_of(options: argparse.Namespace, *left_out: str) -> list[Path]:
    """The files and folders that exist of what options name, but for the output and those of options that are left out.

    A word that an option takes names no folder: one that is called so is another.
    """
    found = []
    for name, value in vars(options).items():
        for one in value if isinstance(value, list) else [value]:
            if name in ("output", "written", *left_out) or not isinstance(one, str | Path):
                continue
            folder = isinstance(one, Path) or (name == "library" and one != EMBEDDED)
            if Path(one).is_file() or (folder and Path(one).is_dir()):
                found.append(Path(one))
    return found


def check_exposure(output: Path, exposure: float | None) -> None:
    """Raise ValueError for an `--exposure` of a file of radiance, which has none."""
    from torchbrdf.images import DISPLAY_SUFFIXES

    if exposure is not None and output.suffix.lower() not in DISPLAY_SUFFIXES:
        raise ValueError(f"{output}: --exposure is of a picture to look at; name it X.png or X.jpg, or leave it out")


def add_table(parser: argparse.ArgumentParser) -> None:
    """The table that a command is about; see `_inputs.open_table`."""
    parser.add_argument("brdf", type=Path, metavar="BRDF", help=TABLE_HELP)


def add_light(
    parser: argparse.ArgumentParser, required: bool = True, default: str | None = None, several: bool = False
) -> None:
    """`--probe` and how to read it; `several`: it may be given once for each photograph, and is a list."""
    text = 'light probe, .exr or .hdr (or .tif, .pfm, .npy); "default" for the embedded one'
    kind: dict[str, Any] = {"action": "append"} if several else {}
    text += "; once for each photograph, or once for all" if several else ""
    parser.add_argument("--probe", required=required and default is None, default=default, help=text, **kind)
    add_reading(parser, "probe")
    text = "linear RGB of photograph, light and BRDF, to which files are converted; default: %(default)s"
    parser.add_argument("--primaries", choices=get_args(ColourSpace), default=DEFAULT_SPACE, help=text)
    parser.add_argument("--repair-probe", action="store_true", help="fill NaN texels of the probe, and say how many")


def add_reading(parser: argparse.ArgumentParser, light: str) -> None:
    """How to read the file of `--probe`, or of another option for a light."""
    parser.add_argument(f"--{light}-layer", metavar="NAME", help="of a file that holds several pictures")
    text = "of the picture; default: latlong"
    parser.add_argument(f"--{light}-layout", choices=get_args(Layout), default="latlong", help=text)
    text = (
        "a lat-long's rows lie at pixel centres (most programs) or run from pole to pole (Mitsuba); default: "
        "what the file says, else centres"
    )
    parser.add_argument(f"--{light}-rows", choices=get_args(Rows), help=text)
    text = (
        "where the disc of a mirror ball or an angular map is, in pixels; default: as the mask has it, else a square "
        "picture is a tight crop"
    )
    kind: dict[str, Any] = {"type": number(), "nargs": 3, "metavar": ("X", "Y", "R"), "action": _Circle}
    parser.add_argument(f"--{light}-circle", **kind, help=text)
    text = "image that is white where such a disc may be used"
    parser.add_argument(f"--{light}-mask", type=Path, metavar="FILE", help=text)
    text = "horizontal field of view of a mirror ball's whole picture, as given; default: seen from infinity"
    parser.add_argument(f"--{light}-fov", type=number(0, 180), metavar="DEG", help=text)
    if light == "probe":
        text = "share of the light that the mirror ball reflects, one number or R G B; default: all"
        parser.add_argument("--mirror-reflectance", type=number(0), nargs="+", metavar="R", help=text)


def add_library(parser: argparse.ArgumentParser) -> None:
    """`--library` and `--without`."""
    text = f"{LIBRARY_HELP}; may be given several times, for one library of all; default: the embedded one"
    parser.add_argument("--library", action="append", metavar="PATH", help=text)
    text = "leave a material out of the library, such as the one that is to be recovered; may be given several times"
    parser.add_argument("--without", action="append", default=[], metavar="NAME", help=text)


def add_shape(parser: argparse.ArgumentParser) -> None:
    """`--view` and the camera before it."""
    group = parser.add_argument_group("the shape and its camera", "axes and units are the mesh's, axes the probe's")
    group.add_argument(
        "--view",
        default="sphere",
        metavar="sphere|NORMALS|MESH",
        help="sphere (default); a mesh, .ply, .obj, .glb or .gltf; or a normal map, X Y Z in R G B, .exr or .png",
    )
    text = (
        "horizontal field of view of the whole picture, as given; default: of a photographed ball what the file says, "
        "else orthographic"
    )
    group.add_argument("--fov", type=number(0, 180), metavar="DEG", help=text)
    three: dict[str, Any] = {"type": number(), "nargs": 3, "metavar": ("X", "Y", "Z")}
    text = "from the target towards the camera; default: 0 0 1"
    group.add_argument("--toward", **three, action=_Direction, help=text)
    group.add_argument("--up", **three, action=_Direction, help="what is up in the image; default: 0 1 0")
    group.add_argument("--target", **three, help="what the camera looks at; default: the middle of the mesh")
    group.add_argument("--width", type=number(0), help="shown at the target; default: the mesh's bounding sphere")
    group.add_argument("--no-shadows", action="store_true", help="light the mesh as if it cast no shadows")


def add_camera(parser: argparse.ArgumentParser) -> None:
    """What else is known of the camera of a whole photograph than `--fov`."""
    group = parser.add_argument_group("the camera of a whole photograph", "instead of --fov, and its lens")
    text = "focal length, with --sensor-mm"
    group.add_argument("--focal-mm", type=number(0), metavar="MM", help=text)
    text = "of the sensor along the photograph's longer side: 36 for full frame"
    group.add_argument("--sensor-mm", type=number(0), metavar="MM", help=text)
    text = "where it looks, in pixels from the top left corner; default: the middle"
    group.add_argument("--principal", type=number(), nargs=2, metavar=("X", "Y"), help=text)
    text = "of the lens, by OpenCV's model: K1 K2 P1 P2 [K3 [K4 K5 K6 [S1 S2 S3 S4]]]"
    group.add_argument("--distortion", type=number(), nargs="+", metavar="K", help=text)


def add_seen(parser: argparse._ActionsContainer) -> None:
    """What of a photograph is used, and how its file is read."""
    text = (
        "image that is white where the shape may be used; default: the photograph's alpha; without one a ball is "
        "found, and of another shape all is used that --view shows"
    )
    parser.add_argument("--mask", type=Path, help=text)
    parser.add_argument("--invert-mask", action="store_true", help="the mask is white around the shape")
    text = "a ball's silhouette in pixels; default: from the mask, else found in the photograph"
    parser.add_argument("--circle", type=number(), nargs=3, metavar=("X", "Y", "R"), action=_Circle, help=text)
    text = "which of the balls found, from 1, the largest; default: the largest, unless another is almost as large"
    parser.add_argument("--ball", type=whole_number(1), metavar="N", help=text)
    parser.add_argument("--layer", metavar="NAME", help="of a photograph that holds several pictures")
    text = "accept a photograph of 8 or 16 bits, decoded as it says, else with sRGB (JPEG) or gamma 2.2"
    parser.add_argument("--allow-ldr", action="store_true", help=text)
    text = "accept it, decoded so, whatever it says"
    parser.add_argument("--encoding", choices=get_args(Encoding), help=text)


def add_photographed(parser: argparse.ArgumentParser) -> None:
    """A photograph's shape, its camera, and what of it is used."""
    add_shape(parser)
    add_camera(parser)
    add_seen(parser.add_argument_group("the photograph"))


def add_estimation(parser: argparse.ArgumentParser) -> None:
    """What is used of a photograph, and how it is explained."""
    add_seen(parser)
    add_library(parser)
    parser.add_argument(
        "--penalty", type=penalty, default=DEFAULT_PENALTY, metavar="auto|paper|X", help=_PENALTY_HELP
    )
    parser.add_argument("--constraint", choices=("none", *CONSTRAINTS), help=_CONSTRAINT_HELP)
    parser.add_argument("--robust", action="store_true", help="leave out pixels that do not fit, such as dead ones")
    add_size(parser, None, "resample to N x N pixels; default: its own, at most 128")


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
