#!/usr/bin/env python3
"""Claim: with the constraint "lobes" the middle of highlights is nearer to the measured one, and pictures are no worse.

    python scripts/make_targets.py --measured ../shared/data/rgl -o targets
    python scripts/benchmarks/highlights.py --targets targets --measured ../shared/data/rgl

Every measured material, photographed under every probe with 1 % noise, is recovered without its family, with each
constraint. Its table is compared with the measured one in cells of theta_h up to 7 degrees, theta_d up to 75: the mean
of |log10((f_r + c) / (measured + c))| with c = 0.01 / sr, and the shares of cells that are more than three times too
bright ("spikes") and too dark ("holes"), within 1.3 degrees of the middle. "Dark": tables of which a report says that
they are dark in the middle of highlights. Pictures: relative RMS error of Y w under the other probes. Seconds: of the
estimate, by photograph. A second table has the same errors of pictures for every fourth material of the library itself,
left out with its family.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import log10
from pathlib import Path

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from calibration import whole_without
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.estimation import CONSTRAINTS, Constraint
from torchbrdf.experiments import (
    Experiment,
    default_probes,
    markdown_table,
    noisy_observations,
    open_probes,
    read_targets,
    relatives,
)
from torchbrdf.images import relative_rms
from torchbrdf.report.doubts import DARK_MIDDLE, darkest_middle

THETA_H = torch.arange(25)
"""Cells: the i-th lies at (i + 1/2)^2 / 90 degrees."""

MIDDLE = 11
"""Of these within 1.3 degrees."""

THETA_D, PHI_D = torch.arange(0, 80, 10), torch.tensor([30, 90, 150])
FLOOR = 0.01
"""In 1/sr: less is black."""

TIMES = 3.0
STEP = 4
"""Every so many-th material of the library."""


@dataclass(frozen=True)
class Found:
    """Errors of one material under one probe with one constraint; dark: whether the report says so."""

    middle: float
    beside: float
    spikes: float
    holes: float
    dark: bool
    pictures: float
    seconds: float


def lobes_of(table: tb.MerlTable) -> Tensor:
    """(25, 8, 3, 3) float64: f_r about the middle of highlights."""
    return table.values[THETA_H[:, None, None], THETA_D[:, None], PHI_D].double()


def judged(found: tb.MerlTable, measured: Tensor, pictures: float, seconds: float) -> Found:
    off = torch.log10((lobes_of(found) + FLOOR) / (measured + FLOOR))
    middle = off[:MIDDLE]
    spikes, holes = ((sign * middle > log10(TIMES)).double().mean().item() for sign in (1, -1))
    dark = darkest_middle(found) < DARK_MIDDLE
    return Found(float(middle.abs().mean()), float(off[MIDDLE:].abs().mean()), spikes, holes, dark, pictures, seconds)


def cases(
    experiment: Experiment, measured: Mapping[str, Tensor], constraints: Sequence[Constraint | None], noise: float
) -> Iterator[tuple[Constraint | None, Found]]:
    """Of all materials of a fold, probes and constraints."""
    library, classes = experiment.library, tb.MaterialClasses.fit(experiment.library)
    for probe in experiment.probes:
        others = [name for name in experiment.probes if name != probe]
        photographs = experiment.observations(probe, [noise])[0]
        for constraint in constraints:
            estimate = tb.BRDFEstimator(experiment.bases[probe], classes, constraint=constraint, library=library)
            estimate(photographs)  # prepares what all photographs share
            start = time.perf_counter()
            results = estimate(photographs)
            seconds = (time.perf_counter() - start) / len(photographs)
            shown = experiment.relit(results.weights, others)
            for i, material in enumerate(experiment.materials):
                errors = [experiment.error(shown[name][i], material, name) for name in others]
                table = results[i].brdf(library)
                yield constraint, judged(table, measured[material], statistics.mean(errors), seconds)


def left_out(
    experiment: Experiment, constraints: Sequence[Constraint | None], noise: float
) -> Iterator[tuple[Constraint | None, float]]:
    """Errors of pictures of the library's own materials."""
    library, bases = experiment.library, experiment.bases
    classes = tb.MaterialClasses.fit(library)
    for material in tqdm(library.names[::STEP], desc="left out", leave=False):
        dropped = relatives(material, library.names)
        less = library.without(*dropped)
        fewer = whole_without(classes, less)
        shown = {name: (basis.image(material).double(), basis.without(*dropped)) for name, basis in bases.items()}
        for probe, (image, basis) in shown.items():
            photograph = noisy_observations(image, [noise], f"{material} {probe}")[0].float()
            for constraint in constraints:
                estimate = tb.BRDFEstimator(basis, fewer, constraint=constraint, library=less)
                weights = estimate(photograph).weights.double()
                others = [pair for name, pair in shown.items() if name != probe]
                errors = [relative_rms(one.render(weights), truth, one.mask) for truth, one in others]
                yield constraint, statistics.mean(errors)


def of_pictures(errors: Sequence[float]) -> list[str]:
    """Mean, 90th percentile and worst, in per cent."""
    ordered = sorted(100 * error for error in errors)
    return [f"{statistics.mean(ordered):.2f} %", f"{ordered[int(0.9 * len(ordered))]:.1f} %", f"{ordered[-1]:.1f} %"]


def run(options: argparse.Namespace) -> None:
    library = tb.MaterialLibrary.default()
    experiment = Experiment.of(library, open_probes(default_probes()), read_targets(options.targets))
    tables = {name: tb.read_table(options.measured / f"{name}.bsdf") for name in experiment.materials}
    measured = {name: lobes_of(table) for name, table in tables.items()}
    constraints = [None, *options.constraints]
    found: dict[Constraint | None, list[Found]] = {one: [] for one in constraints}
    for fold in tqdm(experiment.folds("family"), desc="families", leave=False):
        for constraint, case in cases(fold, measured, constraints, options.noise):
            found[constraint].append(case)
    head = ["constraint", "middle, decades", "beside", "spikes", "holes", "dark"]
    head += ["pictures: mean", "90 %", "worst", "seconds"]
    rows = []
    for constraint, some in found.items():
        middle, beside = (statistics.mean(getattr(case, key) for case in some) for key in ("middle", "beside"))
        spikes, holes = (statistics.mean(100 * getattr(case, key) for case in some) for key in ("spikes", "holes"))
        rows.append(
            [
                constraint or "none",
                f"{middle:.2f}",
                f"{beside:.3f}",
                f"{spikes:.0f} %",
                f"{holes:.0f} %",
                f"{statistics.mean(100 * case.dark for case in some):.0f} %",
                *of_pictures([case.pictures for case in some]),
                f"{statistics.median(case.seconds for case in some):.3f}",
            ]
        )
    print(f"{len(next(iter(found.values())))} photographs, {options.noise:g} % noise\n\n{markdown_table(head, rows)}\n")
    own: dict[Constraint | None, list[float]] = {one: [] for one in constraints}
    for constraint, error in left_out(experiment, constraints, options.noise):
        own[constraint].append(error)
    rows = [[constraint or "none", *of_pictures(errors)] for constraint, errors in own.items()]
    print(markdown_table(["left out of the library", "pictures: mean", "90 %", "worst"], rows))


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--targets", required=True, type=Path, help="folder that make_targets.py wrote")
    parser.add_argument("--measured", required=True, type=Path, help="folder of the measured *.bsdf tables")
    parser.add_argument("--constraints", nargs="+", choices=CONSTRAINTS, default=["lobes"], metavar="NAME")
    parser.add_argument("--noise", type=float, default=1.0, help="in %% of every pixel")
    options = parser.parse_args(argv)
    return exit_status("highlights", run, options)


if __name__ == "__main__":
    sys.exit(main())
