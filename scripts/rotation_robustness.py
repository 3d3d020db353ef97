#!/usr/bin/env python3
"""What a wrong light costs, Tables I, II and III of [CBP21]: a library's materials, each reconstructed without itself.

    python scripts/rotation_robustness.py --library MERL_DIR --probes grace.hdr uffizi.hdr ennis.hdr forest.exr -o OUT

Every material is photographed by simulation under each probe.
Table I    The probe is believed to be turned by 1, 2, 5 and 10 degrees about +X, +Y and +Z.
Table II   Light and belief are turned by 45 to 315 degrees about +Y, the vertical axis.
Table III  Nothing is turned; K = 2 ... 7 classes in N = 4 dimensions, and K = 4 in N = 2 ... 10.

Photographs are the library's own basis images by the harmonic transport, so that nothing but the turn and `--noise`
disturbs them; noise is that of scripts/leave_one_out.py. Novel-light errors are |rendered - truth| / |truth| of the
recovered BRDF under the other probes, mean over them.

OUT gets results.csv, summary.md and plots. OUT/tasks holds one file for each finished method, probe and turn, written
whole or not at all: run the same command again to continue.
"""

import argparse
import itertools
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from statistics import mode
from typing import Any

import torch

import torchbrdf as tb
from leave_one_out import match_classes, open_probes
from paper.rotation.methods import METHODS
from paper.rotation.report import write_report
from paper.rotation.results import Facts, MixtureFacts
from paper.rotation.tasks import AXES, Turn, fit_classes, reconstruct
from torchbrdf.command_line import RESUMABLE, Parser, exit_status
from torchbrdf.estimation import N_CLASSES, N_DIMS
from torchbrdf.experiments import check_document, without_relatives, write_rows
from torchbrdf.sweep import Task, sweep
from torchbrdf.transport.harmonic import transport_of

ANGLES = (1, 2, 5, 10)
TURNS = (45, 90, 135, 180, 225, 270, 315)
CLASSES = (2, 3, 4, 5, 6, 7)
DIMENSIONS = (2, 3, 4, 5, 6, 7, 8, 9, 10)

FITS_TOGETHER = 10
"""Left-out materials whose classes are one task."""

Mixture = tuple[int, int]
"""K and N."""

USUAL: Mixture = (N_CLASSES, N_DIMS)


@dataclass(frozen=True)
class Run:
    """One row of a table and one method: photographs under a turned probe, and how it is believed to be turned."""

    photographed: Turn
    believed: Turn
    mixture: Mixture
    method: str

    @property
    def name(self) -> str:
        """Such as paper-K4-N4-0-5X."""
        k, n = self.mixture
        return f"{self.method}-K{k}-N{n}-{self.photographed}-{self.believed}"


def runs_of(tables: Sequence[int], methods: Sequence[str]) -> list[Run]:
    """Without repetition: all tables need the reconstructions under the true light."""
    aligned, wanted = Turn(), []
    for method in methods:
        own = [table for table in tables if table in METHODS[method].tables]
        wanted += [(aligned, aligned, USUAL, method)] * bool(own)
        if 1 in own:
            wanted += [(aligned, Turn(axis, angle), USUAL, method) for angle in ANGLES for axis in AXES]
        if 2 in own:
            wanted += [(Turn("Y", angle), Turn("Y", angle), USUAL, method) for angle in TURNS]
        if 3 in own:
            wanted += [(aligned, aligned, mixture, method) for mixture in mixtures_of(tables)]
    return list(dict.fromkeys(itertools.starmap(Run, wanted)))


def mixtures_of(tables: Sequence[int]) -> list[Mixture]:
    """K and N of all classes that the tables need."""
    more = [(k, N_DIMS) for k in CLASSES] + [(N_CLASSES, n) for n in DIMENSIONS]
    return list(dict.fromkeys([USUAL, *(more if 3 in tables else [])]))


@dataclass(frozen=True)
class Experiment:
    """What all tasks share: the library and the probes with their places, and the settings."""

    library: tb.MaterialLibrary
    library_path: str
    probes: dict[str, tb.LightProbe]
    probe_paths: dict[str, str]
    materials: list[str]
    noise: list[float]
    size: int
    seed: int

    def fits(self, mixtures: Sequence[Mixture]) -> Iterator[Task]:
        """The classes of the whole library, and without each of the materials."""
        asked = [None, *self.materials]
        for (k, n), start in itertools.product(mixtures, range(0, len(asked), FITS_TOGETHER)):
            some = asked[start : start + FITS_TOGETHER]
            arguments = {"library": self.library.source, "n_classes": k, "n_dims": n, "materials": some}
            yield Task(f"classes-K{k}-N{n}-{some[0] or 'none'}", arguments, {"library_path": self.library_path})

    def reconstructions(
        self, runs: Sequence[Run], labels: dict[Mixture, dict[str | None, str]], every: dict[str, int]
    ) -> Iterator[tuple[Run, str, Task]]:
        """Of every probe and run; labels as `labels_of` gives them."""
        for probe, run in itertools.product(self.probes, runs):
            materials = self.materials[:: every[run.method]]
            arguments = {
                "library": self.library.source,
                "probes": {name: probe.fingerprint for name, probe in self.probes.items()},
                "observed": probe,
                "photographed": [run.photographed.axis, run.photographed.degrees],
                "believed": [run.believed.axis, run.believed.degrees],
                "method": run.method,
                "materials": {name: labels[run.mixture][name] for name in materials},
                "n_dims": run.mixture[1],
                "noise": self.noise,
                "size": self.size,
                "seed": self.seed,
            }
            places = {"library_path": self.library_path, "probe_paths": self.probe_paths}
            yield run, probe, Task(f"{run.name}-{probe}", arguments, places)


def labels_of(tasks: Sequence[Task], results: dict[str, Any]) -> dict[Mixture, dict[str | None, str]]:
    """The classes, a digit a column, by mixture and left-out material; None for the whole library."""
    labels: dict[Mixture, dict[str | None, str]] = {}
    for task in tasks:
        of = labels.setdefault((task.arguments["n_classes"], task.arguments["n_dims"]), {})
        of.update(zip(task.arguments["materials"], results[task.name], strict=True))
    return labels


def agreement(labels: str, reference: str, k: int) -> tuple[list[int], float]:
    """Which of k reference classes each class stands for, and the share of columns that agree."""
    ours, theirs = (torch.tensor([int(label) for label in text]) for text in (labels, reference))
    meaning = match_classes(ours, theirs, max(k, int(theirs.max()) + 1))
    return meaning, float((torch.tensor(meaning)[ours] == theirs).double().mean())


def without(labels: str, library: tb.MaterialLibrary, name: str) -> str:
    """The labels of the library less the family of a material."""
    left = [library.position(one) for one in without_relatives(library, name).names]
    return "".join(labels[3 * i : 3 * i + 3] for i in left)


def mixture_facts(
    labels: dict[Mixture, dict[str | None, str]], library: tb.MaterialLibrary
) -> tuple[dict[Mixture, MixtureFacts], dict[Mixture, dict[str, list[int]]]]:
    """What the fits are like, and what class of the whole library each class without a material stands for."""
    facts, meanings = {}, {}
    for mixture, of in labels.items():
        whole = of[None]
        found = {
            name: agreement(its, without(whole, library, name), mixture[0]) for name, its in of.items() if name
        }
        counts = [len(set(its)) for name, its in of.items() if name]
        meanings[mixture] = {name: meaning for name, (meaning, _) in found.items()}
        facts[mixture] = MixtureFacts(
            sizes=[whole.count(label) for label in sorted(set(whole))],
            fewest=min(counts),
            most=max(counts),
            steady=sum(share for _, share in found.values()) / len(found),
            as_usual=agreement(whole, labels[USUAL][None], mixture[0])[1],
        )
    return facts, meanings


def run(args: argparse.Namespace) -> None:
    """The whole experiment; raises ValueError or OSError for bad input."""
    started = time.perf_counter()
    if any(not 0 <= level < float("inf") for level in args.noise):
        raise ValueError(f"noise levels must be at least 0, got {args.noise}")
    if find_spec("matplotlib") is None:
        raise ValueError("the plots need matplotlib: install torchbrdf[experiments]")
    if args.document is not None:
        check_document(args.document)
    every = {**{name: method.every for name, method in METHODS.items()}, **dict(args.every)}
    probes = open_probes(args.probes)
    library = tb.MaterialLibrary.from_files(args.library)
    materials = list(dict.fromkeys(args.materials or library.names))
    for name in materials:
        library.position(name)
    transport_of(library, progress=True)
    experiment = Experiment(
        library=library,
        library_path=where(args.library),
        probes=probes,
        probe_paths={name: where(path) for name, path in zip(probes, args.probes, strict=True)},
        materials=materials,
        noise=list(dict.fromkeys(args.noise)),
        size=args.size,
        seed=args.seed,
    )
    out = Path(args.output)
    settings: dict[str, Any] = {"processes": args.processes, "scheduler": args.scheduler}
    fits = list(experiment.fits(mixtures_of(args.tables)))
    labels = labels_of(fits, sweep(fit_classes, fits, out / "tasks", progress="classes", **settings))
    facts, meanings = mixture_facts(labels, library)
    runs = runs_of(args.tables, args.methods)
    if not runs:
        raise ValueError(f"none of the methods {', '.join(args.methods)} takes part in these tables; ask for more")
    planned = list(experiment.reconstructions(runs, labels, every))
    results = sweep(reconstruct, [task for *_, task in planned], out / "tasks", progress="reconstructions", **settings)

    kinds = {name: mode(labels[USUAL][None][3 * i : 3 * i + 3]) for i, name in enumerate(library.names)}
    rows = []
    for run, probe, task in planned:
        columns = results[task.name]
        for values in zip(*columns.values(), strict=True):
            row = dict(zip(columns, values, strict=True))
            name, (k, n) = row["material"], run.mixture
            row["class"] = meanings[run.mixture][name][row["class"]]
            key = {"method": run.method, "probe": probe, "photographed": run.photographed, "believed": run.believed}
            rows.append({**key, "n_classes": k, "n_dims": n, **row, "material_class": kinds[name]})
    rows = [{key: f"{x:.6g}" if isinstance(x, float) else str(x) for key, x in row.items()} for row in rows]
    write_rows(out / "results.csv", rows)
    write_report(out, rows, Facts(len(materials), args.size, facts), args.document)
    print((out / "summary.md").read_text())
    print(f"{out}: results.csv, summary.md and plots; {time.perf_counter() - started:.0f} s")


def where(argument: str) -> str:
    """A path that means the same in every process."""
    return argument if argument == "default" else str(Path(argument).resolve())


def stride(text: str) -> tuple[str, int]:
    """METHOD=N."""
    name, _, count = text.partition("=")
    if name not in METHODS or not count.isdecimal() or int(count) < 1:
        known = ", ".join(METHODS)
        raise argparse.ArgumentTypeError(f"expected METHOD=N with METHOD of {known} and N >= 1, got {text!r}")
    return name, int(count)


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser(
        prog="rotation_robustness", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--library", required=True, help="folder of MERL *.binary tables, or `default`")
    parser.add_argument("--probes", nargs="+", required=True, help="lat-long .exr or .hdr files, or `default`")
    parser.add_argument("-o", "--output", required=True, help="folder of the results")
    parser.add_argument("--tables", nargs="+", type=int, choices=(1, 2, 3), default=[1, 2, 3])
    text = "default: paper auto; aligned takes seconds a photograph"
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=["paper", "auto"], help=text)
    parser.add_argument(
        "--every", nargs="+", type=stride, default=[], metavar="METHOD=N",
        help="every N-th material only by this method; 1 for all. Usual: "
        + ", ".join(f"{name}={method.every}" for name, method in METHODS.items()),
    )  # fmt: skip
    parser.add_argument("--noise", nargs="+", type=float, default=[0, 1], help="levels in %% of the pixel's value")
    parser.add_argument("--materials", nargs="+", help="only these; the library stays whole")
    parser.add_argument("--size", type=int, default=64, help="pixels along a side of the images")
    parser.add_argument("--seed", type=int, default=0)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    parser.add_argument("--processes", type=int, default=cores, help=f"on this machine (here {cores}), a core each")
    parser.add_argument(
        "--scheduler", metavar="ADDRESS",
        help="of a Dask cluster that computes instead; its workers see library, probes and scripts at the same paths",
    )  # fmt: skip
    parser.add_argument("--document", type=Path, help="Markdown file whose results, between markers, are replaced")
    return exit_status("rotation_robustness", run, parser.parse_args(argv), RESUMABLE)


if __name__ == "__main__":
    sys.exit(main())
