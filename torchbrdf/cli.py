"""The command line: `torchbrdf demo | fit | live | compare | analytic | render | bake | export | ...`."""

import argparse
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import get_args

import torchbrdf
from torchbrdf.command_line import Parser, exit_status, say
from torchbrdf.commands import (
    alignment,
    analytic,
    bake,
    classes,
    compare,
    demo,
    doctor,
    export,
    fit,
    live,
    precompute,
    render,
    verify,
)
from torchbrdf.constraints import CONSTRAINTS
from torchbrdf.probe import Layout
from torchbrdf.transport import DEFAULT_SAMPLES

NAME = "torchbrdf"
LAYOUTS = get_args(Layout)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit status: 0, 2 for bad input (one line on stderr says what), 130 for Ctrl-C."""
    options = _parser().parse_args(arguments)
    warnings.showwarning = _show_warning
    return exit_status(NAME, options.run, options, interrupted="interrupted; nothing was written")


def _show_warning(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
    say(NAME, f"warning: {message}")


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog=NAME, description=torchbrdf.__doc__)
    parser.add_argument("--version", action="version", version=f"{NAME} {torchbrdf.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, run: Callable[[argparse.Namespace], int]) -> argparse.ArgumentParser:
        text = (run.__doc__ or "").strip()
        added = commands.add_parser(name, help=text.splitlines()[0], description=text)
        added.set_defaults(run=run)
        return added

    def output(added: argparse.ArgumentParser, text: str, default: Path | None = None) -> None:
        added.add_argument("-o", "--output", type=Path, required=default is None, default=default, help=text)

    def light(added: argparse.ArgumentParser, required: bool = True, default: str | None = None) -> None:
        text = 'light probe, .exr or .hdr; "default" for the embedded one'
        added.add_argument("--probe", required=required and default is None, default=default, help=text)
        added.add_argument("--probe-layout", choices=LAYOUTS, default="latlong", help="default: latlong")
        added.add_argument("--repair-probe", action="store_true", help="fill NaN and infinite texels of the probe")

    def library(added: argparse.ArgumentParser) -> None:
        added.add_argument("--library", type=Path, help="folder of MERL *.binary files; default: the embedded library")

    def shape(added: argparse.ArgumentParser) -> None:
        group = added.add_argument_group("the shape and its camera", "axes and units are the mesh's, axes the probe's")
        group.add_argument(
            "--view",
            default="sphere",
            metavar="sphere|NORMALS|MESH",
            help="sphere (default); a mesh, .ply or .obj; or a normal map, .exr, X Y Z in R G B",
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

    def estimation(added: argparse.ArgumentParser) -> None:
        added.add_argument("--mask", type=Path, help="image that is white where the shape may be used")
        text = "silhouette in pixels; default: from the mask"
        added.add_argument("--circle", type=float, nargs=3, metavar=("X", "Y", "R"), help=text)
        library(added)
        added.add_argument(
            "--penalty", type=fit.penalty, default=fit.DEFAULT_PENALTY, metavar="auto|paper|X", help=fit.PENALTY_HELP
        )
        added.add_argument("--constraint", choices=CONSTRAINTS, help=fit.CONSTRAINT_HELP + "; default: none")
        added.add_argument("--robust", action="store_true", help="leave out pixels that do not fit, such as dead ones")
        added.add_argument("--size", type=int, help="resample to N x N pixels; default: its own, at most 128")
        added.add_argument("--allow-ldr", action="store_true", help="accept an 8-bit photograph, taken as gamma 2.2")

    added = command("demo", demo.run)
    output(added, "folder for the results; default: torchbrdf-demo", Path("torchbrdf-demo"))

    added = command("fit", fit.run)
    added.add_argument("photo", type=Path, help="linear HDR photograph of the ball or the shape, .exr or .hdr")
    light(added)
    shape(added)
    added.add_argument("--basis", type=Path, help="basis images of `torchbrdf bake`, for the same probe and view")
    estimation(added)
    alignment.add_options(added)
    added.add_argument("--uncertainty", action="store_true", help=f"also write {fit.STD}: how sure each cell is")
    output(added, "folder for brdf.binary, weights.json, fitted.exr and report.html")

    added = command("live", live.run)
    added.add_argument("photo", type=Path, nargs="?", help="as `fit` takes it; default: the ball of `torchbrdf demo`")
    light(added, required=False)
    shape(added)
    estimation(added)
    added.add_argument("--light", help='another probe to turn instead; "default" for the embedded one')
    added.add_argument("--light-layout", choices=LAYOUTS, default="latlong", help="of --light; default: latlong")
    added.add_argument("--pixels", type=live.pixels, default=live.PIXELS, help="along a sphere; default: %(default)s")
    added.add_argument("--port", type=live.port, default=0, help="of 127.0.0.1; default: any free one")
    added.add_argument("--no-browser", action="store_true", help="print the page's address, and open no browser")

    added = command("compare", compare.run)
    compare.add_options(added)
    light(added, default="default")
    output(added, "X.html")

    added = command("analytic", analytic.run)
    analytic.add_options(added)
    light(added, default="default")

    added = command("render", render.run)
    added.add_argument("brdf", type=Path, help="MERL table, .binary")
    light(added)
    added.add_argument("--size", type=int, default=256, help="pixels along a side; default: 256")
    added.add_argument("--samples", type=int, default=1024, help="samples a pixel, on average; default: 1024")
    added.add_argument("--exposure", type=float, default=1.0, help="factor on the radiance in a .png; default: 1")
    output(added, "X.exr, X.hdr or X.png (gamma 2.2, clipped)")

    added = command("bake", bake.run)
    light(added)
    shape(added)
    library(added)
    added.add_argument("--size", type=int, default=64, help="pixels along a side; default: 64")
    added.add_argument("--samples", type=int, default=DEFAULT_SAMPLES, help="samples a pixel; default: %(default)s")
    added.add_argument("--seed", type=int, default=0, help="of the random numbers; default: 0")
    output(added, "basis images, .safetensors")

    added = command("precompute", precompute.run)
    library(added)

    added = command("export", export.run)
    added.add_argument("brdf", type=Path, help="MERL table, .binary")
    light(added)
    shape(added)
    added.add_argument("--size", type=int, default=256, help="pixels along a side; default: 256")
    output(added, "folder for scene.xml, the files that it names, and render.py")

    added = command("verify", verify.run)
    added.add_argument("directory", type=Path, help="folder of MERL *.binary files")

    added = command("classes", classes.run)
    library(added)
    added.add_argument("--n-classes", type=int, default=torchbrdf.classes.N_CLASSES, help="K; default: %(default)s")
    added.add_argument("--n-dims", type=int, default=torchbrdf.classes.N_DIMS, help="N; default: %(default)s")

    command("doctor", doctor.run)
    return parser


if __name__ == "__main__":
    sys.exit(main())
