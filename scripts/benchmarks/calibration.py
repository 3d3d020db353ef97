#!/usr/bin/env python3
"""Claim: 90 % intervals of re-rendered pixels hold 80-97 % of the true ones, on materials that are not in the library.

    python scripts/make_targets.py --measured ../shared/data/rgl -o targets
    python scripts/benchmarks/calibration.py --targets targets
    python scripts/benchmarks/calibration.py --leave-out 0 10 --step 8

For every material, probe and noise: fit the target under this probe, render mean and standard deviation under each of
the other probes, and compare with the targets there. Interval: mean +- 1.645 standard deviations. Coverage counts
pixels and colour channels. Errors and standard deviations are in units of the pixel plus 0.3 of the image's mean, so
that dark pixels count by their relative error and black ones stay finite. Rivals: the mixture without UNMODELLED, or
with its standard deviations inflated, and intervals that are the same share of these units everywhere, the share being
the best for these very cases. CRPS is the mean absolute error of a whole distribution: smaller is better, and width
without need costs.

With --leave-out the targets are materials of the library, sampled where basis images are of the precomputed transport,
and left out of it together with their family and so many materials most like them. There it is also counted how often
the class of a material is the one named.
"""

import argparse
import itertools
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.estimation.classes import Mixture
from torchbrdf.estimation.posterior import UNMODELLED
from torchbrdf.experiments import (
    Experiment,
    default_probes,
    markdown_table,
    noisy_observations,
    open_probes,
    read_targets,
    relatives,
)
from torchbrdf.transport import DEFAULT_SAMPLES

Z_90, Z_50 = 1.645, 0.6745
DARKEST = 0.3
SETTINGS = tuple((a, b) for a in (1.0, 1.25, 1.5, 2.0) for b in (0.0, UNMODELLED, 2 * UNMODELLED))
"""What standard deviations of the mixture are multiplied by, and UNMODELLED; the default is among them."""

CONSTANTS = tuple(0.0025 * 1.25**i for i in range(22))
PIXEL_STEP = 5
"""Every fifth pixel is compared: cases are correlated far beyond that."""


@dataclass(frozen=True)
class Case:
    """One photograph and one other light; tensors (3, P) in units of the pixel plus 0.3 of the mean.

    error, plain, mean  of the pixels, standard deviations of the mixture alone, and the mean
    radiance            of the truth, relative to its mean
    """

    material: str
    observed: str
    novel: str
    noise: float
    error: Tensor
    plain: Tensor
    mean: Tensor
    radiance: Tensor

    def std(self, inflation: float = 1.0, unmodelled: float = UNMODELLED) -> Tensor:
        """Standard deviations (3, P)."""
        return torch.sqrt((inflation * self.plain) ** 2 + (unmodelled * self.mean) ** 2)


def compare(result: tb.Reconstruction, basis: tb.BasisImages, truth: Tensor, *labels: Any) -> Case:
    """The case of a single result; truth (3, P), labels as in Case."""
    posterior = result.posterior
    rows = basis.packed[..., ::PIXEL_STEP].permute(1, 2, 0)
    root = posterior.factor[..., :-1]
    plain = posterior.std(rows, root).double()
    mean = (rows.double() @ result.weights.double().T[..., None])[..., 0]
    truth = truth.double()
    level = truth.mean(-1, keepdim=True)
    truth = truth[:, ::PIXEL_STEP]
    unit = truth + DARKEST * level
    values = ((truth - mean) / unit, plain / unit, mean / unit, truth / level)
    return Case(*labels, *(one.float() for one in values))


def crps(error: Tensor, std: Tensor) -> Tensor:
    """Continuous ranked probability score of normal distributions [Gneiting and Raftery 2007, eq. 21]."""
    z = error / std
    density = torch.exp(-(z**2) / 2) / math.sqrt(2 * math.pi)
    return std * (z * torch.erf(z / math.sqrt(2)) + 2 * density - 1 / math.sqrt(math.pi))


def log_score(error: Tensor, std: Tensor) -> float:
    """Mean negative log density of normal distributions: smaller is better."""
    return float((0.5 * (error / std) ** 2 + torch.log(std * math.sqrt(2 * math.pi))).double().mean())


def coverage(cases: Sequence[Case], z: float, std: Callable[[Case], Tensor] = Case.std) -> float:
    """Share of pixels whose error is within z standard deviations."""
    return sum(float((case.error.abs() <= z * std(case)).float().mean()) for case in cases) / len(cases)


def rank_correlation(a: Tensor, b: Tensor) -> float:
    """Spearman's."""
    ranks = [one.argsort().argsort().double() for one in (a, b)]
    return float(torch.corrcoef(torch.stack(ranks))[0, 1])


def score_row(name: str, cases: Sequence[Case], std: Callable[[Case], Tensor]) -> list[str]:
    """Coverage, width, scores, and how well the standard deviation knows where the error is."""
    deviations = torch.stack([std(case) for case in cases])
    errors = torch.stack([case.error for case in cases])
    inside = (errors.abs() <= Z_90 * deviations).float().mean((1, 2))
    predicted, actual = (x.square().mean((1, 2)).sqrt() for x in (deviations, errors))
    return [
        name,
        f"{100 * float(inside.mean()):.1f}",
        f"{100 * coverage(cases, Z_50, std):.1f}",
        f"{100 * float(torch.quantile(inside, 0.1)):.0f}",
        f"{100 * 2 * Z_90 * float(deviations.mean()):.1f}",
        f"{100 * 2 * Z_90 * float(deviations.median()):.1f}",
        f"{100 * float(crps(errors, deviations).mean()):.2f}",
        f"{log_score(errors, deviations):.2f}",
        f"{rank_correlation(predicted, actual):.2f}",
    ]


def _std(case: Case, setting: tuple[float, float]) -> Tensor:
    return case.std(*setting)


def _constant(case: Case, share: float) -> Tensor:
    return torch.full_like(case.error, share)


def scores(cases: Sequence[Case]) -> str:
    """Table of all settings and the two best constant widths."""
    head = "intervals|90 % hold|50 % hold|90 % hold, worst tenth|width: mean|median|CRPS|log score|rank correlation"
    rows = []
    for setting in SETTINGS:
        default = " (default)" if setting == (1.0, UNMODELLED) else ""
        name = "inflation {:g}, unmodelled {:.0%}".format(*setting) + default
        rows.append(score_row(name, cases, partial(_std, setting=setting)))
    constants = [score_row(f"constant {share:.1%}", cases, partial(_constant, share=share)) for share in CONSTANTS]
    best = min(range(len(constants)), key=lambda i: float(constants[i][6]))
    nearest = min(range(len(constants)), key=lambda i: abs(float(constants[i][1]) - 90))
    rows += [constants[i] for i in sorted({best, nearest})]
    return markdown_table(head.split("|"), rows)


def halves(cases: Sequence[Case]) -> str:
    """Table: inflation and UNMODELLED of the best log score on every other material, and coverage on the rest."""
    materials = list(dict.fromkeys(case.material for case in cases))
    rows = []
    for tuning in (materials[::2], materials[1::2]):
        some = [case for case in cases if case.material in tuning]
        rest = [case for case in cases if case.material not in tuning]
        errors = torch.stack([case.error for case in some])
        scored = {s: log_score(errors, torch.stack([case.std(*s) for case in some])) for s in SETTINGS}
        best = min(scored, key=lambda setting: scored[setting])
        held = 100 * coverage(rest, Z_90, partial(_std, setting=best))
        rows.append([", ".join(tuning), f"{best[0]:g}", f"{best[1]:.0%}", f"{held:.1f}"])
    return markdown_table(["chosen on", "inflation", "unmodelled", "90 % hold, of the other materials"], rows)


def by(cases: Sequence[Case], key: str) -> str:
    """Table of coverage, width and error for each value of a field."""
    head = [key, "90 % hold", "50 % hold", "width: median", "predicted error", "error"]
    rows = []
    for value in dict.fromkeys(getattr(case, key) for case in cases):
        some = [case for case in cases if getattr(case, key) == value]
        deviations = torch.stack([case.std() for case in some])
        errors = torch.stack([case.error for case in some])
        rows.append(
            [
                str(value),
                f"{100 * coverage(some, Z_90):.1f}",
                f"{100 * coverage(some, Z_50):.1f}",
                f"{100 * 2 * Z_90 * float(deviations.median()):.1f}",
                *(f"{100 * float(x.square().mean().sqrt()):.1f}" for x in (deviations, errors)),
            ]
        )
    return markdown_table(head, rows)


def by_brightness(cases: Sequence[Case]) -> str:
    """Table of coverage in ranges of the pixel's radiance over the image's mean."""
    radiance, errors, deviations = (
        torch.cat([part(case).flatten() for case in cases])
        for part in (lambda case: case.radiance, lambda case: case.error, Case.std)
    )
    rows = []
    for low, high in itertools.pairwise((0.0, 0.1, 0.3, 1.0, 3.0, 10.0, math.inf)):
        some = (radiance >= low) & (radiance < high)
        if some.any():
            inside = (errors[some].abs() <= Z_90 * deviations[some]).float().mean()
            width = 2 * Z_90 * deviations[some].median()
            share = some.float().mean()
            name = f"{low:g} to {high:g} x mean" if high < math.inf else f"above {low:g} x mean"
            rows.append([name, f"{100 * float(share):.1f}", f"{100 * float(inside):.1f}", f"{100 * float(width):.1f}"])
    return markdown_table(["radiance", "pixels", "90 % hold", "width: median"], rows)


def measured(experiment: Experiment, levels: Sequence[float]) -> list[Case]:
    """Cases of targets of other materials."""
    classes = tb.MaterialClasses.fit(experiment.library)
    cases = []
    for probe in tqdm(experiment.probes, desc="fits", leave=False):
        estimator = tb.BRDFEstimator(experiment.bases[probe], classes)
        for level, photographs in zip(levels, experiment.observations(probe, levels), strict=True):
            results = estimator(photographs)
            for i, material in enumerate(experiment.materials):
                result = results[i]
                for novel in experiment.probes:
                    if novel != probe:
                        truth = experiment.view.pack(experiment.targets[novel][material].photograph)
                        cases.append(compare(result, experiment.bases[novel], truth, material, probe, novel, level))
    return cases


Bases = dict[str, tb.BasisImages]


@dataclass(frozen=True)
class Naming:
    """How surely a class was named, how surely its plain evidence names it, and whether it was right."""

    certainty: float
    plain: float
    right: bool


def left_out(
    library: tb.MaterialLibrary, bases: Bases, again: Bases, options: argparse.Namespace, others: int
) -> tuple[list[Case], list[Naming]]:
    """Cases of every `step`-th material, left out together with the `others` that look most like it.

    bases, again  basis images under each probe, and such with other random numbers, whose materials are the targets
    """
    view, step, levels = tb.SphereView(options.size), options.step, options.noise
    angles = likeness(next(iter(bases.values())))
    whole = tb.MaterialClasses.fit(library)
    cases, namings = [], []
    for i in tqdm(range(0, len(library), step), desc="materials", leave=False):
        material = library.names[i]
        nearest = [library.names[j] for j in angles[i].argsort()[: others + 1].tolist()]
        dropped = dict.fromkeys([*nearest, *relatives(material, library.names)])
        classes = whole_without(whole, library.without(*dropped))
        truth = {name: view.pack(one.image(material)) for name, one in again.items()}
        less = {name: one.without(*dropped) for name, one in bases.items()}
        label = int(whole.labels.reshape(-1, 3)[i].mode().values)
        for probe in bases:
            estimator = tb.BRDFEstimator(less[probe], classes)
            observed = noisy_observations(truth[probe].double(), levels, f"{material} {probe}")
            results = estimator(view.unpack(observed))
            posteriors = results.posteriors
            if posteriors is None:
                raise ValueError("the default penalty must give posteriors for its class probabilities to be judged")
            evidence = torch.logsumexp(posteriors.groups[0].log_evidence[:, : classes.n_classes], -1)
            plain, named = torch.softmax(evidence, -1), results.class_probabilities
            for k, level in enumerate(levels):
                result = results[k]
                right = int(named[k].argmax()) == label
                namings.append(Naming(float(named[k].max()), float(plain[k].max()), right))
                for novel in bases:
                    if novel != probe:
                        cases.append(compare(result, less[novel], truth[novel], material, probe, novel, level))
    return cases, namings


def likeness(basis: tb.BasisImages) -> Tensor:
    """(m, m) radians between materials under one light, of their most similar channels; 0 to itself."""
    weight = basis.packed.double().mean(0)
    images = (basis.packed.double() / (weight + DARKEST * weight.mean(-1, keepdim=True))).flatten(1)
    images = images / images.norm(dim=1, keepdim=True)
    angles = torch.acos((images @ images.T).clamp(-1, 1))
    m = len(basis.names)
    return angles.reshape(m, 3, m, 3).amin((1, 3)).fill_diagonal_(-1)


def whole_without(whole: tb.MaterialClasses, library: tb.MaterialLibrary) -> tb.MaterialClasses:
    """The classes of the whole library, less the materials that a smaller one lacks: classes keep their meaning."""
    rows = torch.tensor([3 * whole.names.index(name) + c for name in library.names for c in range(3)])
    mixture = Mixture(
        whole.mixing, whole.means, whole.covariances, whole.responsibilities[rows], whole.history, whole.converged
    )
    return tb.MaterialClasses(mixture, library.names, library.source, whole.norms[rows])


def reliability(namings: Sequence[Naming]) -> str:
    """Table: how sure the most probable class was, and how often it was right."""
    rows = []
    for low, high in itertools.pairwise((0.0, 0.5, 0.65, 0.8, 0.9, 0.99, 1.01)):
        some = [naming for naming in namings if low <= naming.certainty < high]
        if some:
            said = sum(naming.certainty for naming in some) / len(some)
            right = sum(naming.right for naming in some) / len(some)
            rows.append([f"{low:g} to {min(high, 1):g}", str(len(some)), f"{said:.2f}", f"{right:.2f}"])
    plain = sum(naming.plain for naming in namings) / len(namings)
    rows.append(
        [
            f"all; plain evidence says {plain:.2f}",
            str(len(namings)),
            "",
            f"{sum(naming.right for naming in namings) / len(namings):.2f}",
        ]
    )
    return markdown_table(["probability named", "photographs", "mean", "right"], rows)


def run(options: argparse.Namespace) -> None:
    probes = open_probes(options.probes or default_probes())
    folder = options.library
    library = tb.MaterialLibrary.from_files(folder or "default")
    bases: Bases = {}
    again: Bases = {}
    for name, light in tqdm(probes.items() if options.leave_out else (), desc="basis", leave=False):
        view = tb.SphereView(options.size)
        bases[name] = tb.render_basis(library, light, view, "harmonic")
        again[name] = tb.render_basis(library, light, view, samples=4 * DEFAULT_SAMPLES, seed=77)
    for others in options.leave_out or ():
        cases, namings = left_out(library, bases, again, options, others)
        print(f"\nleft out with the {others} most like it: {len(cases)} cases, in per cent\n\n{scores(cases)}")
        print(f"\nthe class named, left out with {others}\n\n{reliability(namings)}")
    if options.leave_out:
        return
    if not options.targets.is_dir():
        raise FileNotFoundError(
            f"{options.targets}: no such folder of targets; make it with scripts/make_targets.py "
            f"--measured ../shared/data/rgl -o {options.targets}"
        )
    experiment = Experiment.of(library, probes, read_targets(options.targets))
    for relation in experiment.relations:
        folds = experiment.folds(relation)
        print(f"\n{experiment.left_out(relation)}\n")
        report(experiment, [case for fold in folds for case in measured(fold, options.noise)], options.noise)


def report(experiment: Experiment, cases: Sequence[Case], levels: Sequence[float]) -> None:
    """All tables of what intervals hold."""
    print(f"{len(cases)} cases of {len(experiment.materials)} materials, in per cent\n\n{scores(cases)}")
    print(f"\n{halves(cases)}")
    for level in levels:
        some = [case for case in cases if case.noise == level]
        print(f"\n{level:g} % pixel noise: 90 % intervals hold {100 * coverage(some, Z_90):.1f}")
    for key in ("observed", "novel", "material"):
        print(f"\n{by(cases, key)}")
    print(f"\n{by_brightness(cases)}")


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--targets", type=Path, default=Path("targets"), help="folder that make_targets.py wrote")
    parser.add_argument("--library", type=Path, help="folder of MERL *.binary tables; default: the embedded library")
    parser.add_argument("--probes", nargs="+", type=Path, metavar="FILE", help="default: 7 of ../shared/data/probes")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0, 1.0], help="in %% of every pixel")
    parser.add_argument(
        "--leave-out", type=int, nargs="+", metavar="N", help="instead: library materials, N most alike"
    )
    parser.add_argument("--step", type=int, default=4, help="with --leave-out: every so many materials")
    parser.add_argument("--size", type=int, default=64, help="with --leave-out: pixels along a side")
    return exit_status("calibration", run, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
