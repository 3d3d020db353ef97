"""`torchbrdf live`: the recovered BRDF under a light that the user turns, in the browser."""

from __future__ import annotations

import argparse
from pathlib import Path, PurePath
from typing import TYPE_CHECKING

from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import add_camera, add_estimation, add_light, add_reading, add_shape, whole_number

if TYPE_CHECKING:
    from torchbrdf.brdf import MaterialLibrary
    from torchbrdf.commands._reconstruction import Fit
    from torchbrdf.light import LightProbe

PIXELS = 128
_OF_A_PHOTOGRAPH = ("probe", "library", "mask", "circle", "ball", "size", "focal_mm", "principal", "distortion")

EXAMPLES = (
    "torchbrdf live",
    "torchbrdf live ball.exr --probe probe.exr --fov 24 --light other.hdr",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """A photograph as `fit` takes it, the light to turn, and where the page is shown."""
    parser.add_argument("photo", type=Path, nargs="?", help="as `fit` takes it; default: the ball of `torchbrdf demo`")
    add_light(parser, required=False)
    add_shape(parser)
    add_camera(parser)
    add_estimation(parser)
    parser.add_argument("--light", help='another probe to turn instead; "default" for the embedded one')
    add_reading(parser, "light")
    text = "along a sphere; default: %(default)s"
    parser.add_argument("--pixels", type=whole_number(16, 512), default=PIXELS, help=text)
    text = "of 127.0.0.1; default: any free one"
    parser.add_argument("--port", type=whole_number(0, 65535), default=0, help=text)
    parser.add_argument("--no-browser", action="store_true", help="print the page's address, and open no browser")


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Turn the light around spheres of the recovered BRDF and of each class's candidate, in the browser."""
    import threading
    import webbrowser

    import torch

    from torchbrdf.commands._reconstruction import summary
    from torchbrdf.live import LiveServer, Relighter, listen

    with listen(options.port) as listener:  # before the fit: a port that is in use is known at once
        title, fitted, library, probe = _recovered(options)
        findings.line(summary(fitted))
        if options.light is not None:
            probe = _other_light(options)
        torch.set_num_threads(max(1, torch.get_num_threads() - 1))  # the browser needs a core
        spheres = Relighter.of(library, fitted.result, probe, options.pixels)
        name = PurePath(probe.name.removeprefix("light probe ")).name
        with LiveServer(spheres, listener, title, name) as server:
            findings.line(f"{server.url} shows it; Ctrl-C ends it", at_once=True)
            if not options.no_browser:
                threading.Thread(target=webbrowser.open, args=(server.url,), daemon=True).start()
            server.serve_until_interrupted()
    return 0


def _recovered(options: argparse.Namespace) -> tuple[str, Fit, MaterialLibrary, LightProbe]:
    """What was photographed, what came of it, the library, and the photograph's light."""
    from torchbrdf.brdf import TABLE_SUFFIXES, MaterialLibrary
    from torchbrdf.commands._capture import doubts_of_light, doubts_of_sight
    from torchbrdf.commands._demonstration import MATERIAL, photographed
    from torchbrdf.commands._inputs import open_library, open_probe
    from torchbrdf.commands._reconstruction import fit
    from torchbrdf.commands._said import say_doubts
    from torchbrdf.commands._sight import read_observation
    from torchbrdf.commands._swapped import telling_swapped
    from torchbrdf.light import LightProbe

    estimation = {"penalty": options.penalty, "constraint": options.constraint, "robust": options.robust}
    if options.photo is None:
        given = [key for key in _OF_A_PHOTOGRAPH if getattr(options, key) is not None]
        if given or options.view != "sphere":
            raise ValueError(f"--{(given or ['view'])[0]} is for a photograph, and none is given")
        whole, probe = MaterialLibrary.default(), LightProbe.default()
        library = whole.without(MATERIAL)
        fitted = fit(photographed(whole.table(MATERIAL), probe), probe, library, **estimation)
        return f"{MATERIAL}, simulated", fitted, library, probe
    if options.photo.is_dir() or options.photo.suffix.lower() in TABLE_SUFFIXES:
        raise ValueError(
            f"{options.photo}: live takes a photograph, with its --probe, and recovers the BRDF itself; what is there "
            f"is shown by `torchbrdf render {options.photo} --probe other.hdr -o other.png` and by report.html"
        )
    if options.probe is None:
        raise ValueError("a photograph needs the light probe of its light: give --probe")
    with telling_swapped(options.photo, options):
        sight, probe = read_observation(options, options.size), open_probe(options)
    say_doubts([*doubts_of_sight(options, sight), *doubts_of_light(probe)])
    library = open_library(options)
    return options.photo.name, fit(sight.observation, probe, library, view=sight.view, **estimation), library, probe


def _other_light(options: argparse.Namespace) -> LightProbe:
    """The probe of `--light`."""
    from torchbrdf.commands._inputs import open_probe

    keys = ("layer", "layout", "rows", "circle", "mask", "fov")
    read = {f"probe_{key}": getattr(options, f"light_{key}") for key in keys}
    read |= {"probe": options.light, "mirror_reflectance": None, "fov": None, "focal_mm": None}
    try:
        return open_probe(argparse.Namespace(**vars(options) | read))
    except ValueError as error:
        raise ValueError(str(error).replace("--probe", "--light")) from None
