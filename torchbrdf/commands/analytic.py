"""`torchbrdf analytic`: a table as the parameters of an analytic BRDF, in a file that other programs open."""

import argparse
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from torchbrdf.analytic import DEFAULT_METRIC, DEFAULT_MODEL, IMAGE_METRIC, MOST_EVALUATIONS, models
from torchbrdf.analytic.export import SUFFIXES
from torchbrdf.brdf import METRIC_NAMES
from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import add_light, add_size, add_table, whole_number
from torchbrdf.files import writing

EXAMPLES = (
    "torchbrdf analytic result --model principled -o material.xml --preview fit.png",
    "torchbrdf analytic gold.binary --model metallic-roughness -o gold.gltf",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is fitted, how, and what is written."""
    add_table(parser)
    parser.add_argument(
        "--model", default=DEFAULT_MODEL, help=f"{', '.join(models.NAMES)}; default: %(default)s", metavar="MODEL"
    )
    metrics = (*METRIC_NAMES, IMAGE_METRIC)
    parser.add_argument("--metric", choices=metrics, default=DEFAULT_METRIC, help="default: %(default)s")
    parser.add_argument("--separate", action="store_true", help="all parameters of each channel, not only colours")
    text = "of the model; default: %(default)s"
    parser.add_argument("--most-evaluations", type=whole_number(1), default=MOST_EVALUATIONS, metavar="N", help=text)
    parser.add_argument("--format", choices=SUFFIXES, help="default: by the file's suffix")
    text = "; ".join(f"{name}: {' or '.join(suffixes)}" for name, suffixes in SUFFIXES.items())
    parser.add_argument("-o", "--output", type=Path, help=f"{text}; default: only print")
    parser.add_argument("--preview", type=Path, help="picture of the table's sphere and the fit's, .png, .exr or .hdr")
    add_size(parser, 192, "pixels along a sphere of it; default: %(default)s")
    add_light(parser, default="default")


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Fit an analytic BRDF to a table and write it for Mitsuba, glTF, MaterialX or OpenPBR, or as a table."""
    from torchbrdf.analytic import fit_analytic, model_of
    from torchbrdf.analytic.export import format_of, native_fit
    from torchbrdf.commands._analytic_files import fit_record, tell_fit, uncertainty_of, write_preview
    from torchbrdf.commands._inputs import about, labels, open_probe, open_table
    from torchbrdf.images import check_image_suffix

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
        uncertainty = uncertainty_of(options.brdf, findings)
        settings = {"uncertainty": uncertainty, "most_evaluations": options.most_evaluations}
        with about(options.brdf):
            fit = fit_analytic(table, options.model, options.metric, shared=not options.separate, **settings)
        tell_fit(fit, findings)
        fits = [fit]
        if wanted is not None and output is not None:
            held = native_fit(fit, table, wanted, **settings)
            if held is not fit:
                what = held.model if held.model != fit.model else f"{held.model} with parameters shared by the channels"
                has_not = f"{wanted.name} has no such model"
                findings.line(f"{has_not}; {options.output} holds {what}, fitted to the same table:")
                tell_fit(held, findings)
                fits.append(held)
            wanted.write(held, output)
            if wanted.caution:
                findings.line(f"caution: {wanted.caution}")
        if preview and probe:
            write_preview(preview, table, fits, probe, options.size, options.primaries)
    cautions = [wanted.caution] if wanted is not None and wanted.caution else []
    findings.add(fits=[fit_record(one) for one in fits], cautions=cautions)
    for path in filter(None, (options.output, options.preview)):
        findings.line(f"wrote {path}")
        findings.add_files(path)
    return 0
