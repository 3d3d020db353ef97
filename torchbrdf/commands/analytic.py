"""`torchbrdf analytic`: a table as the parameters of an analytic BRDF, in a file that other programs open."""

import argparse
import sys
import warnings
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf.analytic_fit import DEFAULT_METRIC, DEFAULT_MODEL, IMAGE, MOST_EVALUATIONS, AnalyticFit, fit_analytic
from torchbrdf.analytic_models import MODELS, model_of
from torchbrdf.brdf_metrics import METRICS
from torchbrdf.commands.fit import STD
from torchbrdf.commands.inputs import about, labels, open_probe, open_table
from torchbrdf.files import writing
from torchbrdf.images import check_image_suffix, write_image
from torchbrdf.merl import MerlTable
from torchbrdf.probe import LightProbe
from torchbrdf.rendering import render_tables
from torchbrdf.report_figures import exposure_for
from torchbrdf.view import SphereView

SAMPLES = 1024
"""Of a pixel of the preview, on average."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """The options that are not shared with other commands."""
    from torchbrdf.analytic_export import FORMATS

    parser.add_argument("brdf", type=Path, metavar="BRDF", help="MERL table, or a folder that `fit` wrote")
    parser.add_argument(
        "--model", default=DEFAULT_MODEL, help=f"{', '.join(MODELS)}; default: %(default)s", metavar="MODEL"
    )
    parser.add_argument("--metric", choices=(*METRICS, IMAGE), default=DEFAULT_METRIC, help="default: %(default)s")
    parser.add_argument("--separate", action="store_true", help="all parameters of each channel, not only colours")
    parser.add_argument(
        "--most-evaluations", type=int, default=MOST_EVALUATIONS, metavar="N", help="of the model; default: %(default)s"
    )
    parser.add_argument("--format", choices=FORMATS, help="default: by the file's suffix")
    suffixes = "; ".join(f"{name}: {' or '.join(one.suffixes)}" for name, one in FORMATS.items())
    parser.add_argument("-o", "--output", type=Path, help=f"{suffixes}; default: only print")
    parser.add_argument("--preview", type=Path, help="picture of the table's sphere and the fit's, .png, .exr or .hdr")
    parser.add_argument("--size", type=int, default=192, help="pixels along a sphere of it; default: %(default)s")


def run(options: argparse.Namespace) -> int:
    """Fit an analytic BRDF to a table and write it for Mitsuba, glTF, MaterialX or OpenPBR, or as a table."""
    from torchbrdf.analytic_export import format_of, native_fit

    model_of(options.model)
    if options.format and not options.output:
        raise ValueError(f"--format {options.format} needs a file to write: -o FILE")
    wanted = None if options.output is None else format_of(options.output, options.format)
    if options.preview is not None:
        check_image_suffix(options.preview)
    with ExitStack() as files:
        output, preview = (path and files.enter_context(writing(path)) for path in (options.output, options.preview))
        table = replace(open_table(options.brdf), name=labels([options.brdf])[0])
        probe = open_probe(options) if preview else None
        uncertainty = _uncertainty(options.brdf)
        settings = {"uncertainty": uncertainty, "most_evaluations": options.most_evaluations}
        with about(options.brdf):
            fit = fit_analytic(table, options.model, options.metric, shared=not options.separate, **settings)
        _say(fit)
        fits = [fit]
        if wanted is not None and output is not None:
            held = native_fit(fit, table, wanted, **settings)
            if held is not fit:
                what = held.model if held.model != fit.model else f"{held.model} with parameters shared by the channels"
                print(f"{wanted.name} has no such model; {options.output} holds {what}, fitted to the same table:")
                _say(held)
                fits.append(held)
            wanted.write(held, output)
            if wanted.caution:
                print(f"caution: {wanted.caution}")
        if preview and probe:
            write_preview(preview, table, fits, probe, options.size)
    for path in filter(None, (options.output, options.preview)):
        print(f"wrote {path}")
    return 0


def write_preview(path: Path, table: MerlTable, fits: list[AnalyticFit], probe: LightProbe, size: int) -> None:
    """Spheres side by side under a probe: the table, and each fit; a .png at the exposure of the table's highlight."""
    view = SphereView(size)
    pictures = render_tables([table, *(fit.table for fit in fits)], probe, view, SAMPLES)
    exposure = exposure_for(pictures[0], view.mask) if path.suffix.lower() == ".png" else 1.0
    write_image(path, torch.cat(list(pictures), dim=-1) * exposure)


def _uncertainty(brdf: Path) -> Tensor | None:
    """The standard deviation of every cell that `torchbrdf fit --uncertainty` left in a folder."""
    if not (brdf / STD).is_file():
        return None
    print(f"cells weigh by their standard deviation in {brdf / STD}")
    return MerlTable.open(brdf / STD).values.clamp_min(0)


def _say(fit: AnalyticFit) -> None:
    print(fit)
    print(f"  {fit.iterations} iterations, {fit.evaluations} evaluations of the model, {fit.seconds:.1f} s")
    for bound in fit.at_bounds:
        print(f"  at a bound: {bound}")
    sys.stdout.flush()
    for warning in fit.warnings:
        warnings.warn(f"{fit.name}, {fit.model}: {warning}", UserWarning, stacklevel=2)
