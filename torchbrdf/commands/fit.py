"""`torchbrdf fit`: from a photograph of a ball, or of another known shape, to its BRDF."""

import argparse
from pathlib import Path
from typing import get_args

from torchbrdf.alignment import Range
from torchbrdf.commands._options import STD, add_camera, add_estimation, add_light, add_output, add_shape, add_strict
from torchbrdf.files import writing_folder

_ONLY_WITH_ALIGN = ("search", "keep_silhouette", "blur", "exposure", "white_balance")


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is photographed, under which light, and how it is explained."""
    text = "linear HDR photograph of the ball or the shape: .exr, .hdr, .tif, .pfm or .npy"
    parser.add_argument("photo", type=Path, help=text)
    add_light(parser)
    add_shape(parser)
    add_camera(parser)
    parser.add_argument("--basis", type=Path, help="basis images of `torchbrdf bake`, for the same probe and view")
    add_estimation(parser)
    group = parser.add_argument_group("alignment of the light probe with the photograph")
    text = "find the rotation of the probe, the silhouette of the ball, and the radiance of clipped lamps"
    group.add_argument("--align", action="store_true", help=text)
    text = "near: within about 20 degrees (default); full: also any turn about the vertical axis"
    group.add_argument("--search", choices=get_args(Range), help=text)
    text = "do not search the ball's silhouette, too: it is exact as found or given"
    group.add_argument("--keep-silhouette", action="store_true", help=text)
    group.add_argument("--blur", action="store_true", help="find a blur of the probe, too")
    text = "find a factor of the photograph, too, and divide by it; rarely certain to better than 50 %%"
    group.add_argument("--exposure", action="store_true", help=text)
    group.add_argument("--white-balance", action="store_true", help="the same for each colour channel")
    parser.add_argument("--uncertainty", action="store_true", help=f"also write {STD}: how sure each cell is")
    add_strict(parser)
    add_output(parser, "folder for brdf.binary, weights.json, fitted.exr and report.html")


def run(options: argparse.Namespace) -> int:
    """Recover the BRDF of a photographed ball, or another known shape: brdf.binary, weights.json, report.html."""
    from torchbrdf.brdf import MerlTable, above_horizon
    from torchbrdf.commands import _alignment
    from torchbrdf.commands._inputs import open_library, open_probe
    from torchbrdf.commands._reconstruction import fit, summary, write_results
    from torchbrdf.commands._sight import read_observation
    from torchbrdf.transport import BasisImages

    check_options(options)
    with writing_folder(options.output) as folder:
        size = options.size
        if options.basis is not None and size is None:
            size = BasisImages.load(options.basis).size[1]
        sight = read_observation(options, size)
        probe = open_probe(options)
        lit = ", ".join(filter(None, (probe.name.removeprefix("light probe "), probe.reading)))
        library = open_library(options)
        basis = None if options.basis is None else BasisImages.load(options.basis, library, probe, sight.view)
        settings = {
            "title": options.photo.name,
            "photograph": sight.about,
            "light probe": lit,
            "colours": f"linear {options.primaries}",
        }
        observation = sight.observation
        written = "brdf.binary, weights.json, fitted.exr and report.html"
        if not options.align:
            _alignment.warn_of_lamps(probe, None)
        else:
            found = _alignment.aligned(options, sight, probe, library)
            _alignment.warn_of_lamps(probe, found)
            _alignment.warn_of_turn(found)
            _alignment.warn_of_blur(found)
            sight, probe = _alignment.seen_anew(sight, found), found.probe
            observation = _alignment.divided(sight.observation, found)
            basis = _alignment.basis_of(found)
            _alignment.write(folder, found, options.primaries)
            settings["alignment"] = str(found)
            written = f"alignment.json, aligned_probe.exr, {written}"
        fitted = fit(
            observation, probe, library, options.penalty, sight.view, basis, options.constraint, options.robust
        )
        write_results(folder, fitted, settings, options.primaries, sight.scene)
        if options.uncertainty:
            deviation = fitted.result.brdf_std(library).double()
            MerlTable(deviation, above_horizon(), "standard deviation").save(folder / STD)
            written = f"{STD}, {written}"
    if not options.uncertainty:
        (options.output / STD).unlink(missing_ok=True)  # of an earlier photograph
    print(f"photograph {sight.about}")
    print(f"light {lit}; {fitted.subject.basis.description}")
    if options.align:
        print(found)
    print(summary(fitted))
    print(f"wrote {options.output}/{written}")
    return 0


def check_options(options: argparse.Namespace) -> None:
    """Raise ValueError for options that do not go together."""
    for name in _ONLY_WITH_ALIGN:
        if getattr(options, name) and not options.align:
            raise ValueError(f"--{name.replace('_', '-')} is a part of the alignment: give --align, too")
    if options.align and options.basis is not None:
        raise ValueError("--basis holds images under the probe as it is, and --align turns it: leave one of them out")
    if options.uncertainty and options.penalty != "auto":
        raise ValueError(f"--uncertainty needs --penalty auto, a fixed one has no posterior; got {options.penalty}")
