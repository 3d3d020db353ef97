"""`torchbrdf fit`: from a photograph of a ball, or of another known shape, to its BRDF."""

import argparse
from pathlib import Path
from typing import get_args

from torchbrdf.alignment import Range
from torchbrdf.brdf import RESULT, RESULT_STD, TABLE_SUFFIXES
from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import add_camera, add_estimation, add_light, add_output, add_shape, add_strict
from torchbrdf.files import writing_folder
from torchbrdf.progress import told_if_slow

_ONLY_WITH_ALIGN = ("search", "keep_silhouette", "blur", "exposure", "white_balance")

_OF_FILES = (*TABLE_SUFFIXES, ".exr", ".hdr", ".html", ".json", ".png")
"""Suffixes that no folder is meant to have."""

EXAMPLES = (
    "torchbrdf fit ball.exr --probe probe.exr --fov 24 -o result",
    "torchbrdf fit photographs/ --probe probe.exr --align --no-report --json -o results > found.json",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is photographed, under which light, and how it is explained."""
    text = (
        "linear HDR photograph of the ball or the shape: .exr, .hdr, .tif, .pfm or .npy; several, or a folder of them, "
        "are of as many materials: each gets a folder OUTPUT/NAME"
    )
    parser.add_argument("photos", type=Path, nargs="+", metavar="PHOTO", help=text)
    text = "they are of one material: explain them together"
    parser.add_argument("--same-material", action="store_true", help=text)
    add_light(parser, several=True)
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
    parser.add_argument("--uncertainty", action="store_true", help=f"also write {RESULT_STD}: how sure each cell is")
    parser.add_argument("--no-report", action="store_true", help="make no report.html, which takes the longest")
    text = "of several photographs, explain those again that are finished"
    parser.add_argument("--overwrite", action="store_true", help=text)
    add_strict(parser)
    add_output(parser, "folder for brdf.binary, weights.json, fitted.exr and report.html")


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Recover the BRDF of a photographed ball, or another known shape: brdf.binary, weights.json, report.html."""
    from torchbrdf.commands._photographs import photographs

    options.probes = options.probe
    check_options(options)
    given = photographs(options)
    if options.same_material and len(given) > 1:
        from torchbrdf.commands._joint import fit_together

        return fit_together(options, given, findings)
    if options.same_material or (len(given) == 1 and not options.photos[0].is_dir()):
        return _fit_one(given[0].its(options), findings)
    from torchbrdf.commands._batch import fit_each

    return fit_each(options, given, findings)


def _fit_one(options: argparse.Namespace, findings: Findings) -> int:
    from torchbrdf.commands._lit_sight import Inputs, lit_sight
    from torchbrdf.commands._reconstruction import notes, summary, weights_record
    from torchbrdf.commands._results import (
        check_inputs_stay,
        obsolete,
        products,
        say_doubts_of,
        write_table,
        write_views,
        written,
    )
    from torchbrdf.commands._weights import WEIGHTS, write_weights
    from torchbrdf.report import in_words

    files = products(options)
    check_inputs_stay(options, [options.output])
    with writing_folder(options.output, WEIGHTS, obsolete(options.output)) as folder:
        inputs = Inputs(options)
        with told_if_slow(f"reading {options.photo} and its light, and finding what they show"):
            lit = lit_sight(options, inputs)
        with told_if_slow(f"explaining {options.photo} by the library"):
            setting = inputs.estimates.setting(lit.probe, lit.view, lit.basis)
            (fitted,) = inputs.estimates.fits([lit.observation], setting)
        if options.no_report:
            (fitted,) = inputs.estimates.combined([fitted])
            say_doubts_of(fitted)
        with told_if_slow(f"making {in_words(files)}"):
            write_table(folder, fitted, options.uncertainty)
            grade = write_views(folder, lit, fitted, options)
        write_weights(folder, weights_record(fitted) | {"primaries": options.primaries})
    findings.line(f"photograph {lit.about}")
    findings.line(f"light {lit.light}; {setting.basis.description}")
    if lit.found is not None:
        findings.line(lit.found)
    findings.line(summary(fitted))
    findings.notes.extend(notes(fitted))
    if grade is not None:
        findings.line(grade)
    findings.line(f"wrote {options.output}/{in_words(files)}")
    findings.add_files(*(options.output / file for file in files))
    if options.json:
        said = {"warnings": findings.warnings, "notes": findings.notes}
        findings.add(photographs=[written(options.photo, options.output, files, said, fitted, grade=grade)])
    return 0


def check_options(options: argparse.Namespace) -> None:
    """Raise ValueError for options that do not go together, and for an output that is called as a file is."""
    if options.output.suffix.lower() in _OF_FILES and not options.output.is_dir():
        raise ValueError(
            f"{options.output}: fit writes a folder of files, {RESULT} among them; give -o a name without "
            f"{options.output.suffix}"
        )
    for name in _ONLY_WITH_ALIGN:
        if getattr(options, name) and not options.align:
            raise ValueError(f"--{name.replace('_', '-')} is a part of the alignment: give --align, too")
    if options.align and options.basis is not None:
        raise ValueError("--basis holds images under the probe as it is, and --align turns it: leave one of them out")
    if options.uncertainty and options.penalty != "auto":
        raise ValueError(f"--uncertainty needs --penalty auto, a fixed one has no posterior; got {options.penalty}")
