"""`torchbrdf analytic`: a table, and its photograph, as an analytic BRDF in a file that other programs open."""

import argparse
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from torchbrdf.analytic import (
    DEFAULT_METRIC,
    DEFAULT_MODEL,
    IMAGE_METRIC,
    MOST_EVALUATIONS,
    MOST_ON_A_PHOTOGRAPH,
    models,
)
from torchbrdf.analytic.export import SUFFIXES
from torchbrdf.brdf import METRIC_NAMES
from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import add_light, add_photographed, add_size, add_table, whole_number
from torchbrdf.files import writing
from torchbrdf.progress import told_if_slow

EXAMPLES = (
    "torchbrdf analytic result -o material.xml --preview fit.png",
    "torchbrdf analytic result --photograph ball.exr --probe probe.exr --fov 24 -o material.glb",
    "torchbrdf analytic gold.binary -o gold.gltf",
)

_POOR = 0.1
"""Relative error above which a fit is said to show the material badly: pictures of it then differ by 15 % and more."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is fitted, how, and what is written."""
    add_table(parser)
    parser.add_argument(
        "--model", help=f"{', '.join(models.NAMES)}; default: that of the file, else {DEFAULT_MODEL}", metavar="MODEL"
    )
    metrics = (*METRIC_NAMES, IMAGE_METRIC)
    parser.add_argument("--metric", choices=metrics, default=DEFAULT_METRIC, help="default: %(default)s")
    parser.add_argument("--separate", action="store_true", help="all parameters of each channel, not only colours")
    text = f"of the model; default: {MOST_EVALUATIONS} on a table, {MOST_ON_A_PHOTOGRAPH} on a photograph"
    parser.add_argument("--most-evaluations", type=whole_number(1), metavar="N", help=text)
    parser.add_argument("--format", choices=SUFFIXES, help="default: by the file's suffix")
    text = "; ".join(f"{name}: {' or '.join(suffixes)}" for name, suffixes in SUFFIXES.items())
    parser.add_argument("-o", "--output", type=Path, help=f"{text}; default: only print")
    text = "picture of the table's sphere and the fit's, .png, .jpg, .exr or .hdr"
    parser.add_argument("--preview", type=Path, help=text)
    add_size(parser, 192, "pixels along a sphere of it; default: %(default)s")
    add_light(parser, required=False)
    text = "the photograph that the table comes from, with its --probe: parameters go on from the table's on it"
    parser.add_argument("--photograph", type=Path, metavar="PHOTO", help=text)
    add_photographed(parser)


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Fit an analytic BRDF to a table and write it for Mitsuba, glTF, MaterialX or OpenPBR, or as a table.

    With the photograph that the table comes from, and its light, the parameters are then refined on it.
    """
    from torchbrdf.analytic import fit_analytic, model_of
    from torchbrdf.analytic.export import format_of, native_fit
    from torchbrdf.commands._analytic_files import Fits, uncertainty_of, write_preview
    from torchbrdf.commands._inputs import about, labels, open_probe, open_table
    from torchbrdf.commands._refinement import Refinement, check_pair
    from torchbrdf.images import DEFAULT_SPACE, check_image_suffix
    from torchbrdf.mitsuba_startup import mitsuba_program

    check_pair(options)
    if options.format and not options.output:
        raise ValueError(f"--format {options.format} needs a file to write: -o FILE")
    wanted = None if options.output is None else format_of(options.output, options.format)
    if wanted is not None and options.primaries != DEFAULT_SPACE:
        raise ValueError(
            f"{options.output}: a material's file is in {DEFAULT_SPACE}, and --primaries is {options.primaries}; fit "
            f"the photograph again with --primaries {DEFAULT_SPACE}, or leave -o out"
        )
    model = model_of(options.model or (DEFAULT_MODEL if wanted is None else wanted.model)).name
    if options.preview is not None:
        check_image_suffix(options.preview)
    options.probe = options.probe or "default"
    with ExitStack() as files:
        output, preview = (path and files.enter_context(writing(path)) for path in (options.output, options.preview))
        table = replace(open_table(options.brdf, options.primaries), name=labels([options.brdf])[0])
        probe = open_probe(options) if preview or options.photograph else None
        refinement = Refinement.of(options, probe) if probe and options.photograph else None
        uncertainty = uncertainty_of(options.brdf, findings)
        most: int = options.most_evaluations or MOST_EVALUATIONS
        settings: dict[str, Any] = {"uncertainty": uncertainty, "most_evaluations": most}
        if refinement is not None:
            findings.line(f"photograph {refinement.sight.about}")
        with about(options.brdf), told_if_slow(f"fitting {model} to {options.brdf}"):
            fit = fit_analytic(table, model, options.metric, shared=not options.separate, **settings)
        fits = Fits(findings, refinement, options.most_evaluations)
        best = fits.tell(fit)
        if wanted is not None and output is not None:
            held = native_fit(fit, table, wanted, **settings)
            if held is not fit:
                what = held.model if held.model != fit.model else f"{held.model} with parameters shared by the channels"
                has_not = f"{wanted.name} has no such model"
                findings.line(f"{has_not}; {options.output} holds {what}, fitted to the same table:")
                best = fits.tell(held)
            wanted.write(best, output)
            if wanted.note:
                findings.notes.append(wanted.note)
        if preview and probe:
            write_preview(preview, table, fits, probe, options.size, options.primaries)
    findings.add(fits=fits.records)
    if best.error > _POOR:
        text = f"{best.model} is {best.error:.0%} off, so no parameters of it show this material well"
        findings.notes.append(f"{text}; another --model may, or `torchbrdf export`, which writes the table itself")
    shown = f": from left to right {', '.join([table.name, *fits.labels])}"
    for path, what in ((options.output, ""), (options.preview, shown)):
        if path is not None:
            findings.line(f"wrote {path}{what}")
            findings.add_files(path)
    if options.output is not None and options.output.suffix.lower() == ".xml":
        findings.line(f"`{mitsuba_program(options.output)}` renders it")
    return 0
