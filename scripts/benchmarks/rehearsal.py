#!/usr/bin/env python3
"""Claim: what is said before a photograph comes true: how far off it will be, and which second one to take.

    python scripts/make_targets.py --measured ../shared/data/rgl -o targets
    python scripts/benchmarks/rehearsal.py --targets targets

Of each probe: the error that a rehearsal with the library's own materials predicts (`BRDFEstimator.rehearse`, under
`other_lights`), mean and by kind, and that of measured materials photographed under it, each without its family, under
the other probes, recovered as `fit` does. Then of each probe as the first photograph's: the second that the rehearsal
suggests among the other probes, judged by the ones that are left, beside a random second and the best in hindsight;
errors are of measured materials under the probes that neither photograph shows. In per cent.
"""

import argparse
import itertools
import math
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from calibration import rank_correlation
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.experiments import Experiment, default_probes, markdown_table, open_probes, percent, read_targets
from torchbrdf.light import other_lights

FACTOR = 1.5
"""A prediction holds that is off by no more."""

Pair = tuple[str, ...]
"""One probe or two."""


def measured(folds: Sequence[Experiment], shown: Pair) -> Tensor:
    """(materials, other probes): errors of photographs under the probes, in the order of the folds."""
    found = []
    for fold in folds:
        bases, classes = [fold.bases[name] for name in shown], tb.MaterialClasses.fit(fold.library)
        estimator = tb.BRDFEstimator(bases, classes, constraint="lobes", library=fold.library)
        weights = estimator([fold.observations(name, [0])[0] for name in shown]).weights
        rendered = fold.relit(weights, [name for name in fold.probes if name not in shown])
        for i, material in enumerate(fold.materials):
            found.append([fold.error(images[i], material, name) for name, images in rendered.items()])
    return torch.tensor(found, dtype=torch.float64)


def within(errors: Tensor, told: float | Tensor) -> Tensor:
    """Shares of errors (..., n) that are within FACTOR of what was told, a number or (..., 1)."""
    return ((errors / told).log().abs() < math.log(FACTOR)).double().mean(-1)


def best_share(errors: Tensor) -> float:
    """The largest share of errors (n,) that any one figure would have had `within`."""
    least = FACTOR * (1 - 1e-9) * errors[:, None]  # a figure may be raised until it leaves the smallest that it holds
    return float(within(errors, least).max())


def of_lights(experiment: Experiment, classes: tb.MaterialClasses, errors: dict[Pair, Tensor]) -> str:
    """What is predicted of each probe beside what comes."""
    rows, predicted, shares = [], [], []
    for name, probe in tqdm(experiment.probes.items(), desc="lights", leave=False):
        lights = [tb.render_basis(experiment.library, light, experiment.view) for light in other_lights(probe)]
        told = tb.BRDFEstimator(experiment.bases[name], classes).rehearse(lights)
        predicted.append(told.error)
        each = errors[name,].mean(1)
        shares.append((float(within(each, told.error)), best_share(each)))
        kinds = ", ".join(percent(error) for error in told.by_kind.values())
        rows.append([name, percent(told.error), kinds, percent(float(each.mean())), f"{100 * shares[-1][0]:.0f} %"])
    actual = torch.stack([errors[name,].mean() for name in experiment.probes])
    share, most = map(statistics.mean, zip(*shares, strict=True))
    head = ["light", "predicted", "dull, glossy, mirror-like", "measured materials", f"within {FACTOR:g} x"]
    said = f"{100 * share:.0f} % of all pairs of material and light are within {FACTOR:g} x of what was predicted, "
    said += f"{100 * most:.0f} % would be with the best figure for each light in hindsight; "
    said += f"lights are ranked with a correlation of {rank_correlation(torch.tensor(predicted), actual):.2f}."
    return f"{markdown_table(head, rows)}\n\n{said}"


def of_pairs(experiment: Experiment, classes: tb.MaterialClasses, errors: dict[Pair, Tensor]) -> str:
    """The second photograph that is suggested for each probe, beside others."""
    bases = experiment.bases
    predicted = {
        pair: tb.BRDFEstimator([bases[name] for name in pair], classes)
        .rehearse([bases[name] for name in bases if name not in pair])
        .error
        for pair in tqdm([pair for pair in errors if len(pair) == 2], desc="pairs", leave=False)
    }
    means = {pair: float(errors[pair].mean()) for pair in predicted}
    rows, figures = [], []
    for first in bases:
        pairs = [pair for pair in predicted if first in pair]
        chosen = min(pairs, key=predicted.__getitem__)
        (second,) = (name for name in chosen if name != first)
        three = means[chosen], statistics.mean(means[pair] for pair in pairs), min(means[pair] for pair in pairs)
        figures.append(three)
        rows.append([first, second, *map(percent, three)])
    suggested, by_chance, best = map(statistics.mean, zip(*figures, strict=True))
    rows.append(["mean", "", *map(percent, (suggested, by_chance, best))])
    head = ["first", "suggested second", "with it", "with a random one", "with the best in hindsight"]
    correlation = rank_correlation(*(torch.tensor(list(each.values())) for each in (predicted, means)))
    said = f"The suggested second has {suggested / by_chance:.2f} x the error of a random one, the best in hindsight "
    said += f"{best / by_chance:.2f} x; all pairs are ranked with a correlation of {correlation:.2f}."
    return f"{markdown_table(head, rows)}\n\n{said}"


def run(options: argparse.Namespace) -> None:
    library = tb.MaterialLibrary.from_files(options.library or "default")
    targets = read_targets(options.targets)
    experiment = Experiment.of(library, open_probes(options.probes or default_probes()), targets)
    folds, classes = experiment.folds("family"), tb.MaterialClasses.fit(library)
    names = list(experiment.probes)
    shown = [*((name,) for name in names), *itertools.combinations(names, 2)]
    errors = {one: measured(folds, one) for one in tqdm(shown, desc="photographs", leave=False)}
    print(f"{len(experiment.materials)} materials, library of {len(library)}, {experiment.left_out('family')}; in %\n")
    print(of_lights(experiment, classes, errors))
    print()
    print(of_pairs(experiment, classes, errors))


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--targets", type=Path, default=Path("targets"), help="folder that make_targets.py wrote")
    parser.add_argument("--library", type=Path, help="folder of measured tables; default: the embedded library")
    parser.add_argument("--probes", nargs="+", type=Path, metavar="FILE", help="default: 7 of ../shared/data/probes")
    return exit_status("rehearsal", run, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
