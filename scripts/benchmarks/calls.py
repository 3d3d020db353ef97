#!/usr/bin/env python3
"""Claim: in Python the steps of a reconstruction take milliseconds, beside version 0.6.0 at no larger errors.

    git worktree add ../torchbrdf-0.6.0 8a03668
    python scripts/benchmarks/calls.py --rival ../torchbrdf-0.6.0 --document docs/results/speed_calls.md

Each part is a process of this version and of the rival in turn, which opens library and transport before it times
anything, and runs the same code of public names (speed/called.py) on the same inputs, 64 x 64 pixels. Seconds are
medians of all repeats of all rounds after a warm-up, for each photograph where there are several; a new probe is one
that the process has not seen.

Each version has its own embedded library, of 116 and of 100 materials. Errors: of estimates, the relative RMS
difference of renderings of the weights to those of the photographed materials under the light turned by 180 degrees,
mean of 64 materials that no combination of the library gives (one where one is fitted); of basis images and renderings,
to converged ones (speed/references.py), whose own error is beside it; of `align`, degrees between the rotation that is
found and the true one; of `brdf`, the difference to the sum in float64. The rival of the estimator within a version is
`torch.linalg.lstsq`, looped over classes and channels, with the fastest of its drivers (solver.py).
"""

import argparse
import json
import statistics
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

import torchbrdf as tb
from speed.called import BATCH, Seconds
from speed.checkouts import Checkout, both, machine, speed_options
from speed.inputs import Inputs
from speed.judging import Error, Judge, accurate, left
from speed.rows import Row, in_words, kept, publish, report
from speed.settings import PROBES, RENDERED_UNDER, TABLES
from torchbrdf.command_line import RESUMABLE, Parser, exit_status

LIMITS = {"one": 1.6e-3, "batch": 0.3e-3, "factors": 0.05, "reconstruction": 0.12, "brdf": 0.12}
BASIS_LIMIT, RENDER_LIMIT = (0.06, 0.005), (0.15, 0.003)
"""Seconds and errors."""

BEFORE = {"lamps": 0.0086}
"""Errors of basis images by probe that are more than that, and need be no less than they were."""

ALIGN_LIMITS = {"near": 1.0, "full": 3.0}

NAMES = {
    "one": "`BRDFEstimator`, one photograph",
    "batch": f"`BRDFEstimator`, each of {BATCH}",
    "factors": "factors of a new probe",
    "reconstruction": "new probe to reconstruction",
    "brdf": "`result.brdf(library)`",
}


@dataclass(frozen=True)
class Found:
    """What one version's process of a part gave: seconds by name, and the folder of results."""

    seconds: Seconds
    folder: Path

    def median(self, name: str) -> float:
        """Of all repeats."""
        return statistics.median(self.seconds[name])

    def tensor(self, name: str) -> Tensor:
        """A result."""
        loaded: Tensor = torch.load(self.folder / f"{name}.pt")
        return loaded


def beside(name: str, what: str, found: Mapping[bool, Found], limit: float | None, times: int = 1) -> Row:
    """A row with the seconds of this version (True) and of its rival (False)."""
    now, before = (found[mine].median(name) / times for mine in (True, False))
    return Row(what, now, before, limit)


def judged(row: Row, now: Error, before: Error, limit: float | None = None, remark: str = "") -> Row:
    """With the errors of both versions."""
    reached = accurate(now, limit)
    return replace(row, accurate=reached, error_now=now.words, error_before=before.words, remark=remark)


def solving_rows(judge: Judge, found: Mapping[bool, Found]) -> Iterator[Row]:
    now, before = (judge.shown(found[mine].tensor("batch")) for mine in (True, False))
    one = beside("one", NAMES["one"], found, LIMITS["one"])
    yield one
    batch = beside("batch", NAMES["batch"], found, LIMITS["batch"], BATCH)
    yield judged(batch, now, before)
    factors = beside("factors", NAMES["factors"], found, LIMITS["factors"])
    first = {mine: found[mine].median("factors") - found[mine].median("one") for mine in found}
    remark = "first photograph of a new probe, less another's"
    yield replace(factors, now=first[True], before=first[False], remark=remark)
    path, weights = found[True].folder / "combined.binary", found[True].tensor("combined")
    rounding = judge.combined(path, weights, tb.MaterialLibrary.default())
    yield replace(beside("brdf", NAMES["brdf"], found, LIMITS["brdf"]), error_now=rounding)


def lighting_rows(judge: Judge, found: Mapping[bool, Found]) -> Iterator[Row]:
    library = tb.MaterialLibrary.default()
    for name in PROBES:
        if f"basis {name}" in found[True].seconds:
            row = beside(f"basis {name}", f"new probe to basis images, {name}", found, BASIS_LIMIT[0])
            error, own = judge.basis(found[True].tensor(f"basis-{name}"), name, library)
            remark = f"median, 95 %, worst of {library.n}; the reference's own: {own}"
            reached = accurate(error, BEFORE.get(name, BASIS_LIMIT[1]))
            yield replace(row, accurate=reached, error_now=error.words, remark=remark)
    row = beside("reconstruction", NAMES["reconstruction"], found, LIMITS["reconstruction"])
    now, before = (judge.shown(found[mine].tensor("reconstruction")) for mine in (True, False))
    yield judged(row, now, before)


def rendering_rows(judge: Judge, found: Mapping[bool, Found]) -> Iterator[Row]:
    for light in RENDERED_UNDER:
        for table in TABLES:
            images = [found[mine].tensor(f"render-{table}-{light}") for mine in (True, False)]
            now, before = (judge.picture(image, table, light) for image in images)
            row = beside(f"render {table}, {light}", f"`tb.render`, {table}, {light}", found, RENDER_LIMIT[0])
            first = (in_words(found[mine].median(f"first {table}, {light}")) for mine in (True, False))
            remark = "first picture of a table: {}, before {}".format(*first)
            yield judged(row, now, before, RENDER_LIMIT[1], remark)


def aligning_rows(judge: Judge, found: Mapping[bool, Found]) -> Iterator[Row]:
    for search, limit in ALIGN_LIMITS.items():
        now, before = (left(found[mine].tensor(f"align-{search}"), search) for mine in (True, False))
        row = beside(f"align {search}", f'`tb.align`, "{search}"', found, limit)
        yield judged(row, now, before)


ROWS = {
    "solving": solving_rows, "lighting": lighting_rows, "rendering": rendering_rows, "aligning": aligning_rows
}  # fmt: skip

ORDER = [
    *(NAMES[name] for name in ("one", "batch", "factors")),
    *(f"new probe to basis images, {name}" for name in PROBES),
    *(NAMES[name] for name in ("reconstruction", "brdf")),
    *(f"`tb.render`, {table}, {light}" for light in RENDERED_UNDER for table in TABLES),
    *(f'`tb.align`, "{search}"' for search in ALIGN_LIMITS),
]


def processes(
    part: str, versions: Mapping[bool, Checkout], inputs: Inputs, work: Path, rounds: int, repeats: int
) -> dict[bool, Found]:
    """Both versions in turn, rounds times; results are those of the last."""
    seconds: dict[bool, Seconds] = {mine: {} for mine in versions}
    for _ in range(rounds):
        for mine, version in versions.items():
            output = work / f"{part}-{mine}"
            output.mkdir(exist_ok=True)
            version.run(["-m", "speed.called", part, str(inputs.folder), str(output), str(repeats)], work)
            for name, values in json.loads((output / "seconds.json").read_text()).items():
                seconds[mine].setdefault(name, []).extend(values)
    return {mine: Found(seconds[mine], work / f"{part}-{mine}") for mine in versions}


def rows(
    versions: Mapping[bool, Checkout], judge: Judge, work: Path, options: argparse.Namespace, failed: list[str]
) -> Iterator[Row]:
    """Of the parts that are asked for; those of which a process fails are named."""

    def measured(part: str, some: Mapping[bool, Checkout]) -> dict[bool, Found]:
        return processes(part, some, judge.inputs, work, options.rounds, options.repeats)

    revision = f"{versions[True].revision}, medians of {options.rounds} x {options.repeats}"
    for part in options.only:
        try:
            found = measured(part, versions)
            some = list(ROWS[part](judge, found))
            if part == "solving":
                rival = measured("looped", {True: versions[True]})[True].median("looped")
                ratios = [f"{rival / found[mine].median('one'):.1f}" for mine in (True, False)]
                looped = f"looped `lstsq`: {in_words(rival)}, {ratios[0]} times as long (before {ratios[1]})"
                some[0] = replace(some[0], remark=f"{looped}; to reach: 20")
        except RuntimeError as error:  # the other parts are worth having
            print(error, file=sys.stderr)
            failed.append(f"\n**Failed**: {part}.")
            continue
        for row in some:
            print(f"{row.what}: " + " | ".join(filter(None, row.cells()[1:])), file=sys.stderr, flush=True)
            yield replace(row, revision=revision)


def run(options: argparse.Namespace) -> None:
    now, before = both(options)
    judge, failed = Judge.of(options.folder), list[str]()
    with tempfile.TemporaryDirectory(prefix="torchbrdf-calls-", dir=options.folder) as work:
        found = rows({False: before, True: now}, judge, Path(work), options, failed)
        everything = kept(options.folder / "calls.json", found, ORDER)
    about = f"{machine()}; {now.name} beside {before.name}, medians by the clock."
    publish(report(everything, about, now.name, before.name) + "".join(failed), options.document)


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--only", nargs="+", choices=ROWS, default=list(ROWS), metavar="PART", help=", ".join(ROWS))
    parser.add_argument("--rounds", type=int, default=3, help="processes of each version; default: %(default)s")
    parser.add_argument("--repeats", type=int, default=5, help="in each process; default: %(default)s")
    speed_options(parser)
    return exit_status("calls", run, parser.parse_args(argv), RESUMABLE)


if __name__ == "__main__":
    sys.exit(main())
