#!/usr/bin/env python3
"""Claim: every further photograph of a material lowers the error under light that none of them shows.

    python scripts/benchmarks/several_photographs.py --targets targets --library merl \
        --figure docs/figures/several_photographs.png

Four probes in a row (each of the seven begins one) give one to four photographs, solved jointly; errors are those under
the other three probes, so they are the same for every number of photographs. Novel-light error in per cent. Each
material is recovered without its family, where the library holds it.
"""

import argparse
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path

import torch
from tqdm import tqdm

import torchbrdf as tb
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.estimation import Penalty
from torchbrdf.experiments import Experiment, default_probes, markdown_table, open_probes, read_targets
from torchbrdf.files import writing

MOST = 4
PENALTIES: dict[str, Penalty] = {"default": "auto", "paper": "paper"}


def errors(experiment: Experiment, level: float) -> dict[tuple[str, int], list[float]]:
    """(setting, number of photographs) -> errors of all cases."""
    names, classes = list(experiment.probes), tb.MaterialClasses.fit(experiment.library)
    found: dict[tuple[str, int], list[float]] = {}
    photographs = {name: experiment.observations(name, [level])[0] for name in names}
    for start in tqdm(range(len(names)), desc="probes", leave=False):
        ordered = names[start:] + names[:start]
        for setting, penalty in PENALTIES.items():
            for count in range(1, MOST + 1):
                shown = ordered[:count]
                estimator = tb.BRDFEstimator([experiment.bases[name] for name in shown], classes, penalty)
                weights = estimator([photographs[name] for name in shown]).weights
                for novel, rendered in experiment.relit(weights, ordered[MOST:]).items():
                    found.setdefault((setting, count), []).extend(
                        experiment.error(rendered[i], material, novel)
                        for i, material in enumerate(experiment.materials)
                    )
    return found


def table(found: dict[tuple[str, int], list[float]]) -> str:
    """A row for each number of photographs."""
    head = ["photographs", *(f"{name}: {what}" for name in PENALTIES for what in ("mean", "median", "90 %", "worst"))]
    rows = []
    for count in range(1, MOST + 1):
        row = [str(count)]
        for name in PENALTIES:
            cases = torch.tensor(found[name, count], dtype=torch.float64) * 100
            row += [f"{float(x):.2f}" for x in (cases.mean(), cases.median(), cases.quantile(0.9), cases.max())]
        rows.append(row)
    return markdown_table(head, rows)


def draw(path: Path, found: dict[tuple[str, int], list[float]], floor: float) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.8, 3.2), layout="constrained")
    axes = figure.subplots()
    counts = range(1, MOST + 1)
    for name, colour in zip(PENALTIES, ("#009e73", "#0072b2"), strict=True):
        axes.plot(counts, [100 * statistics.mean(found[name, k]) for k in counts], "o-", color=colour, label=name)
    axes.axhline(100 * floor, color="#888888", linestyle=":", label="floor: all seven probes at once")
    axes.set(xlabel="photographs", ylabel="mean novel-light error, %", xticks=list(counts), ylim=(0, None))
    axes.legend(frameon=False, loc="center right", bbox_to_anchor=(1, 0.57))
    with writing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=130)


def run(options: argparse.Namespace) -> None:
    library = tb.MaterialLibrary.from_files(options.library or "default")
    experiment = Experiment.of(library, open_probes(default_probes()), read_targets(options.targets))
    for relation in experiment.relations:
        folds = experiment.folds(relation)
        found: dict[tuple[str, int], list[float]] = {}
        for fold in folds:
            for key, some in errors(fold, options.noise).items():
                found.setdefault(key, []).extend(some)
        floor = statistics.mean(case.novel_error for fold in folds for case in fold.floor())
        title = f"{options.noise:g} % pixel noise, {experiment.left_out(relation)}, floor {100 * floor:.2f}"
        print(f"{title}\n\n{table(found)}\n")
        if options.figure is not None and relation == "family":
            draw(options.figure, found, floor)


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--targets", required=True, type=Path, help="folder that make_targets.py wrote")
    parser.add_argument("--library", type=Path, help="folder of MERL *.binary tables; default: the embedded library")
    parser.add_argument("--noise", type=float, default=0.0, help="in %% of every pixel")
    parser.add_argument("--figure", type=Path, metavar="PNG", help="draw the curves")
    options = parser.parse_args(argv)
    return exit_status("several_photographs", run, options)


if __name__ == "__main__":
    sys.exit(main())
