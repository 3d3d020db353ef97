#!/usr/bin/env python3
"""What a reconstruction buys an inverse renderer: the tables of docs/results/inverse_rendering.md.

    python scripts/make_targets.py --measured ../shared/data/rgl -o targets
    python scripts/benchmarks/precondition.py --targets targets --library merl -o OUT

An analytic BRDF is fitted to one photograph, through our transport, from the usual start, from random ones, and from
the fit to our reconstruction. Photographs show measured materials, rendered by Mitsuba, and materials that are the
model itself. A run has arrived where its loss is at most 1.05 times the best of any run on its photograph; the table
says after how many evaluations and seconds. Errors are those of re-renderings under the probes that were not
photographed.

OUT holds one file a finished case: run the same command again to continue.
"""

import argparse
import statistics
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any, get_args

from precondition_cases import precondition
from torchbrdf.analytic import MODELS, Method
from torchbrdf.command_line import RESUMABLE, Parser, exit_status
from torchbrdf.experiments import SHARED, SweepInputs, read_targets, sweep_options
from torchbrdf.files import writing
from torchbrdf.sweep import Task, sweep

NEAR_BEST = 1.05
"""A run has arrived where its loss, the sum of squares, is at most this times the best."""

KINDS = {"default": "usual start", "random": "random start", "reconstruction": "our reconstruction"}

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Run:
    """One run: its start, where it ended, and when it arrived; evaluations and seconds are None where it never did."""

    method: str
    kind: str
    loss_over_best: float
    evaluations: int | None
    seconds: float | None
    novel_error: float

    @classmethod
    def of(cls, row: Row, best: float) -> "Run":
        """Of a row of `precondition`, and the best loss of its photograph."""
        arrived = next((one for one in zip(*row["history"], strict=True) if one[2] <= NEAR_BEST * best), None)
        evaluations, seconds = (None, None) if arrived is None else arrived[:2]
        kind = row["start"].split()[0]
        return cls(row["method"], kind, row["loss"] / best, evaluations, seconds, row["novel_error"])


def runs_of(case: Row) -> list[Run]:
    """The runs of a photograph, judged by the best of them."""
    best = min(row["loss"] for row in case["runs"])
    return [Run.of(row, best) for row in case["runs"]]


def median(values: Sequence[float]) -> float:
    return statistics.median(values) if values else nan


def line(name: str, method: str, kind: str, runs: Sequence[Run], limit: int) -> str:
    """One line of the table. Runs that never arrived count with `limit` evaluations in the median."""
    arrived = [run for run in runs if run.evaluations is not None]
    evaluations = [limit if run.evaluations is None else run.evaluations for run in runs]
    seconds = [run.seconds for run in arrived if run.seconds is not None]
    return (
        f"| {name} | {method} | {KINDS[kind]} | {len(runs)} | {len(arrived) / len(runs):.0%} | "
        f"{median(evaluations):.0f} | {f'{median(seconds):.2f}' if seconds else '–'} | "
        f"{median([run.loss_over_best for run in runs]):.2f} | {max(run.loss_over_best for run in runs):.2f} | "
        f"{100 * sum(run.novel_error for run in runs) / len(runs):.1f} |"
    )


def report(cases: Sequence[Row]) -> str:
    """Tables in Markdown: every kind of photograph, model, method and start."""
    head = (
        "| photographs | method | start | runs | arrived | evaluations until then, median | seconds, median of those | "
        "loss over best, median | worst | novel error, % |"
    )
    lines = [head, "|---|---|---" + "|---:" * 7 + "|"]
    groups = sorted({(case["model"], case["planted"]) for case in cases})
    for model, planted in groups:
        some = [case for case in cases if (case["model"], case["planted"]) == (model, planted)]
        name = f"{model}, {'planted' if planted else 'measured'}"
        for method in get_args(Method):
            runs = [run for case in some for run in runs_of(case) if run.method == method]
            rows = [row for case in some for row in case["runs"] if row["method"] == method]
            limit = max((row["history"][0][-1] for row in rows), default=0)
            lines += [
                line(name, method, kind, [run for run in runs if run.kind == kind], limit)
                for kind in KINDS
                if any(run.kind == kind for run in runs)
            ]
    lines.append("\n| photographs | fit to our reconstruction, novel error, % | reconstruction itself, % | seconds |")
    lines.append("|---|---:|---:|---:|")
    for model, planted in groups:
        some = [case for case in cases if (case["model"], case["planted"]) == (model, planted)]
        means = [100 * sum(case[key] for case in some) / len(some) for key in ("fit_error", "reconstruction_error")]
        seconds = median([case["seconds_before"] for case in some])
        name = f"{model}, {'planted' if planted else 'measured'}"
        lines.append(f"| {name} | {means[0]:.1f} | {means[1]:.1f} | {seconds:.2f} |")
    return "\n".join([*lines, "", *comparisons(cases)])


def comparisons(cases: Sequence[Row]) -> list[str]:
    """The start from our reconstruction beside the usual one, photograph by photograph."""
    lines = []
    for method in get_args(Method):
        pairs = []
        for case in cases:
            runs = {run.kind: run for run in runs_of(case) if run.method == method}
            if runs:
                pairs.append((runs["default"], runs["reconstruction"]))
        if not pairs:
            continue
        worse = sum(ours.loss_over_best > NEAR_BEST * usual.loss_over_best for usual, ours in pairs)
        stuck = [ours for usual, ours in pairs if usual.evaluations is None]
        both = [
            (usual.evaluations, ours.evaluations)
            for usual, ours in pairs
            if usual.evaluations is not None and ours.evaluations is not None
        ]
        share = median([ours / usual for usual, ours in both])
        lines.append(
            f"{method}: of {len(pairs)} photographs the start from our reconstruction ended worse than the usual one "
            f"(by more than 5 %) in {worse}; where the usual start never arrived ({len(stuck)}), ours did in "
            f"{sum(ours.evaluations is not None for ours in stuck)}; where both did, it took {share:.2f} of the "
            f"evaluations (median), at most a third in {sum(3 * ours <= usual for usual, ours in both)} of {len(both)}."
        )
    return lines


def run(options: argparse.Namespace) -> int:
    targets = read_targets(options.targets)
    inputs = SweepInputs.open(options.library, options.probes, {target.probe for target in targets})
    strange = set(options.observed) - set(inputs.probes)
    if strange:
        raise ValueError(f"{options.targets}: no targets under {', '.join(sorted(strange))}, to be --observed")
    places = {**inputs.places, "targets": str(options.targets.resolve())}
    common = {
        "library": inputs.library.source,
        "probes": inputs.probes,
        "methods": options.methods,
        "random_starts": options.random_starts,
        "noise": options.noise,
        "size": targets[0].size,
        "seed": options.seed,
    }
    materials: list[tuple[str, int | None]] = [(name, None) for name in sorted({target.material for target in targets})]
    materials += [(f"planted-{draw}", draw) for draw in range(options.planted)]
    labels = [
        {"model": model, "observed": observed, "material": material, "planted": planted}
        for model in options.models
        for observed in options.observed
        for material, planted in materials
    ]
    tasks = [
        Task(f"{label['model']}-{label['observed']}-{label['material']}", common | label, places) for label in labels
    ]
    found = sweep(precondition, tasks, options.output / "cases", options.processes, options.scheduler, "photographs")
    cases = [
        {**found[task.name], "model": label["model"], "planted": label["planted"] is not None}
        for task, label in zip(tasks, labels, strict=True)
    ]
    table = report(cases)
    with writing(options.output / "precondition.md") as path:
        path.write_text(table + "\n")
    print(table)
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--targets", type=Path, required=True, help="folder of scripts/make_targets.py")
    parser.add_argument("--probes", type=Path, default=SHARED / "probes", help="folder of the probes")
    parser.add_argument("--observed", nargs="+", default=["uffizi", "apartment"], help="probes to photograph under")
    parser.add_argument("--library", type=Path, help="folder of MERL tables; default: the embedded library")
    parser.add_argument("--models", nargs="+", choices=list(MODELS), default=["ggx", "principled"], metavar="MODEL")
    parser.add_argument("--methods", nargs="+", choices=get_args(Method), default=list(get_args(Method)))
    parser.add_argument("--planted", type=int, default=10, help="materials that are the model itself; default: 10")
    parser.add_argument("--random-starts", type=int, default=3, help="beside the usual one; default: 3")
    parser.add_argument("--noise", type=float, default=1.0, help="of a pixel, in per cent; default: 1")
    parser.add_argument("--seed", type=int, default=0, help="of the noise and of the random starts")
    sweep_options(parser)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the cases and precondition.md")
    return exit_status("precondition", run, parser.parse_args(argv), RESUMABLE)


if __name__ == "__main__":
    sys.exit(main())
