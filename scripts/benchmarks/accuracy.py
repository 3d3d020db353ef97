#!/usr/bin/env python3
"""Claim: under new light the default estimator is closer to unseen materials than least squares and the paper's.

    python scripts/make_targets.py --measured ../shared/data/rgl -o targets
    python scripts/benchmarks/accuracy.py --targets targets --library merl --noise 0 1

For every material and probe: fit the target under this probe, render the result under each of the other probes.
error = |rendered - target| / |target| over the channels of the pixels under the mask, in per cent. Channels below
zero, colours outside the gamut of RGB, are set to 0 in the targets, as in any photograph. Always beside the settings
asked for: naive least squares (all columns in one class, no penalty), one class with lambda 0.5 and 0.005, the paper's
four classes with lambda 0.5, the default estimator; and the floor: least squares on all probes at once, each with the
same weight, which is the best that any combination of the library's columns can do on average.

Pixel noise of s %: each pixel and channel times 1 + s e / 100, e standard normal. The targets' own Monte Carlo noise n
adds to the error e of a perfect result, too: the column "less noise" is the mean of sqrt(e^2 - n^2).
A library that holds materials of the targets' families is measured twice: each target is recovered without its family
(its name before the colour, as `cc` or `vch`), then without itself alone.
With --tables the table that a user would save, whose cells below zero are clamped, is rendered instead of Y w (slow).
With --merl-targets the targets are MERL tables, rendered by torchbrdf with other random numbers than the basis.
"""

import argparse
import statistics
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from tqdm import tqdm

import torchbrdf as tb
from torchbrdf.brdf import table_paths
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.experiments import (
    BASELINES,
    Experiment,
    Target,
    breakdown_table,
    common_exposure,
    default_probes,
    on_white,
    open_probes,
    parse_choice,
    parse_value,
    percent,
    read_targets,
    settings_of,
    summary_table,
    write_rows,
    write_sheet,
)
from torchbrdf.transport import DEFAULT_SAMPLES

SIZE = 64
"""Pixels along a side of the targets of --merl-targets."""

FIGURE_SHOWS = tuple(setting for setting in BASELINES if setting.name != "one class 0.5")


def merl_targets(folder: Path, probes: Mapping[str, tb.LightProbe], size: int) -> list[Target]:
    """MERL tables as targets, rendered by torchbrdf with four times the samples of basis images; noise not known: 0."""
    view, targets = tb.SphereView(size), []
    for i, path in enumerate(tqdm(table_paths(folder), desc="targets", leave=False)):
        table = tb.MerlTable.open(path)
        for j, (name, probe) in enumerate(probes.items()):
            image = tb.render(table, probe, view, 4 * DEFAULT_SAMPLES, seed=1000 * (j + 1) + i)
            targets.append(Target(path.stem, name, probe.fingerprint, image, 0.0, {}))
    return targets


def figure(path: Path, folds: Sequence[Experiment], observed: str, novel: str, materials: Sequence[str]) -> None:
    """A picture: photographs, the truth under the novel probe, and there what the baselines make of the photographs."""
    known = {material: fold for fold in folds for material in fold.materials}
    for name in (observed, novel):
        if name not in folds[0].probes:
            raise ValueError(f"--figure: there are targets under {', '.join(folds[0].probes)}, not under {name}")
    for material in materials:
        if material not in known:
            raise ValueError(f"--figure-materials: there are {', '.join(known)}, not {material}")
    rows = {}
    for material in materials or sorted(known):
        fold = known[material]
        i = fold.materials.index(material)
        photograph, truth = fold.observations(observed, [0])[0, i], fold.targets[novel][material].photograph
        shown = [(photograph, common_exposure([photograph])), (truth, common_exposure([truth]))]
        for setting in FIGURE_SHOWS:
            classes = tb.MaterialClasses.fit(fold.library, **setting.classes)
            result = tb.BRDFEstimator(fold.bases[observed], classes, **setting.estimator)(photograph[None])
            shown.append((fold.relit(result.weights, [novel])[novel][0], common_exposure([truth])))
        rows[material.removesuffix("_rgb")] = [on_white(image, fold.view.mask, scale) for image, scale in shown]
    titles = [
        f"photograph,\n{observed}",
        f"truth,\n{novel}",
        *(f"{setting.name},\n{novel}" for setting in FIGURE_SHOWS),
    ]
    write_sheet(path, rows, titles, tile=88)


def run(options: argparse.Namespace) -> None:
    choices = {"n_classes": options.n_classes, "penalty": [parse_value(value) for value in options.penalty]}
    choices = {key: values for key, values in choices.items() if values} | dict(map(parse_choice, options.setting))
    settings = [*BASELINES, *settings_of(choices)]
    if options.merl_targets is None and not options.targets.is_dir():
        raise FileNotFoundError(
            f"{options.targets}: no such folder of targets; make it with scripts/make_targets.py "
            f"--measured ../shared/data/rgl -o {options.targets}"
        )
    probes = open_probes(options.probes or default_probes())
    unknown = [name for name in options.observe or () if name not in probes]
    if unknown:
        raise ValueError(f"--observe {unknown[0]}: there are the probes {', '.join(probes)}")
    library = tb.MaterialLibrary.from_files(options.library or "default")
    folder = options.merl_targets
    targets = read_targets(options.targets) if folder is None else merl_targets(folder, probes, SIZE)
    experiment = Experiment.of(library, probes, targets, options.tables)
    if options.figure:
        path, observed, novel = options.figure
        figure(Path(path), experiment.folds("family"), observed, novel, options.figure_materials)

    print(
        f"{len(experiment.materials)} materials, {len(experiment.probes)} probes, {experiment.view.size[0]} x "
        f"{experiment.view.size[1]} pixels, library of {len(library)}; "
        f"{'whole tables' if options.tables else 'Y w'}; errors in per cent"
    )
    own = [target.noise for target in targets]
    if any(own):
        negative = max(targets, key=lambda target: target.negative)
        print(
            f"targets' own noise: mean {percent(statistics.mean(own))}, largest {percent(max(own))}; colours below "
            f"zero: at most {percent(negative.negative)} of the norm ({negative.material}, {negative.probe}), set to 0"
        )
    rows = []
    for relation in experiment.relations:
        folds = experiment.folds(relation)
        floor = [case for fold in folds for case in fold.floor()]
        cases = [case for fold in folds for case in fold.cases(settings, options.noise, options.observe)]
        rows += [asdict(case) | {"left_out": relation} for case in [*cases, *floor]]
        for level in options.noise:
            title = f"{level:g} % pixel noise, {experiment.left_out(relation)}"
            some = [case for case in cases if case.noise == level] + floor
            print(f"\n{title}\n\n{summary_table(some)}")
            for by in ("material", "observed", "novel"):
                print(f"\n{title}: observation / novel light by {by}\n\n{breakdown_table(some, by)}")
    if options.csv:
        write_rows(options.csv, rows)


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--targets", type=Path, default=Path("targets"), help="folder that make_targets.py wrote")
    parser.add_argument("--merl-targets", type=Path, metavar="FOLDER", help="instead: *.binary tables to recover")
    parser.add_argument("--library", type=Path, help="folder of MERL *.binary tables; default: the embedded library")
    parser.add_argument("--probes", nargs="+", type=Path, metavar="FILE", help="default: 7 of ../shared/data/probes")
    parser.add_argument("--observe", nargs="+", metavar="NAME", help="photographs only under these; default: under all")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0], help="in %% of every pixel")
    parser.add_argument("--penalty", nargs="+", default=[], help="of BRDFEstimator, several values")
    parser.add_argument("--n-classes", nargs="+", type=int, default=[], help="of MaterialClasses.fit, several values")
    parser.add_argument(
        "--setting", nargs="+", default=[], metavar="KEY=VALUE,...", help="values of any other argument of these two"
    )
    parser.add_argument("--tables", action="store_true", help="render whole tables instead of Y w")
    parser.add_argument("--csv", type=Path, help="write every case")
    parser.add_argument(
        "--figure", nargs=3, metavar=("PNG", "OBSERVED", "NOVEL"), help="draw results under a new probe"
    )
    parser.add_argument("--figure-materials", nargs="+", default=[], metavar="NAME", help="of these; default: of all")
    options = parser.parse_args(argv)
    return exit_status("accuracy", run, options)


if __name__ == "__main__":
    sys.exit(main())
