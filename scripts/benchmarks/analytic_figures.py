#!/usr/bin/env python3
"""The pictures of docs/analytic.md: analytic fits beside the tables, and inverse rendering from two starts.

    python scripts/benchmarks/analytic_figures.py --library merl --targets targets --materials MATERIAL [...]
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from torch import Tensor

import torchbrdf as tb
from precondition_cases import picture
from torchbrdf.analytic import CellTransport, model_of
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.experiments import SHARED, Target, common_exposure, on_white, write_sheet
from torchbrdf.rendering import render_tables

MATERIALS = ("gold-paint", "blue-acrylic", "brass", "green-latex")
MODELS = ("metallic-roughness", "ggx", "cook-torrance", "ashikhmin-shirley", "low-microfacet", "principled")
STEPS = 150
"""Of gradient descent, in the second picture."""


def shown(images: Sequence[Tensor], mask: Tensor, scale: float) -> list[Tensor]:
    """Pictures of a row at one exposure."""
    return [on_white(image, mask, scale) for image in images]


def models_sheet(library: tb.MaterialLibrary, probe: tb.LightProbe, path: Path) -> None:
    """A row for each material: its table, and the fits of each model, under one light."""
    view, rows = tb.SphereView(160), {}
    for name in MATERIALS:
        table = library.table(name)
        fits = [tb.fit_analytic(table, model).table for model in MODELS]
        images = render_tables([table, *fits], probe, view, samples=2048)
        rows[name] = shown(list(images), view.mask, common_exposure(list(images[:1])))
    write_sheet(path, rows, ["table", *MODELS], 160)


def starts_sheet(
    library: tb.MaterialLibrary, observed: Path, other: Path, targets: Path, materials: Sequence[str], path: Path
) -> None:
    """A row for each measured material: photograph, and under another light the truth, both starts, both ends."""
    size = Target.open(targets / observed.stem / f"{materials[0]}.exr").size
    view = tb.SphereView(size)
    probe, light = tb.LightProbe.open(observed, rows="poles"), tb.LightProbe.open(other, rows="poles")
    lit, new = (CellTransport.build(one, view, 4096) for one in (probe, light))
    estimate = tb.BRDFEstimator(tb.render_basis(library, probe, view), tb.MaterialClasses.fit(library))
    model, rows = model_of("ggx"), {}
    for name in materials:
        photograph = Target.open(targets / observed.stem / f"{name}.exr").photograph
        truth = Target.open(targets / other.stem / f"{name}.exr").photograph
        result = estimate(photograph)
        start = tb.fit_analytic(result, "ggx", library=library)
        ends = [
            tb.fit_analytic_to_image(
                photograph, probe, view, "ggx", start=one, method="adam", most_evaluations=STEPS, transport=lit
            )
            for one in (model.defaults, start.parameters)
        ]
        parameters = [model.defaults, ends[0].parameters, start.parameters, ends[1].parameters]
        images = [truth, *(picture(new, model.evaluate(one, new.geometry)) for one in parameters)]
        images.append(tb.render(result.brdf(library), light, view))
        scale = common_exposure([truth])
        first = on_white(photograph, view.mask, common_exposure([photograph]))
        rows[name] = [first, *shown(images, view.mask, scale)]
    titles = ["photograph", "new light: truth", "usual start", f"after {STEPS} steps", "our start"]
    write_sheet(path, rows, [*titles, f"after {STEPS} steps", "reconstruction"], 160)


def run(options: argparse.Namespace) -> None:
    options.output.mkdir(parents=True, exist_ok=True)
    library = tb.MaterialLibrary.from_merl(options.library)
    uffizi = tb.LightProbe.open(options.probes / "uffizi.hdr", rows="poles")
    models_sheet(library, uffizi, options.output / "analytic_models.png")
    starts_sheet(
        library,
        options.probes / "apartment.exr",
        options.probes / "uffizi.hdr",
        options.targets,
        options.materials,
        options.output / "analytic_starts.png",
    )


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--library", type=Path, required=True, help="folder of MERL tables")
    parser.add_argument("--targets", type=Path, required=True, help="folder of scripts/make_targets.py")
    parser.add_argument("--probes", type=Path, default=SHARED / "probes", help="folder of the probes")
    parser.add_argument("--materials", nargs="+", required=True, help="targets in the second picture")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/figures"), help="folder; default: docs/figures")
    return exit_status("analytic_figures", run, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
