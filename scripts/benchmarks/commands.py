#!/usr/bin/env python3
"""Claim: what a person waits for at the command line is close to what its parts cost, beside version 0.6.0.

    git worktree add ../torchbrdf-0.6.0 8a03668
    python scripts/benchmarks/commands.py --rival ../torchbrdf-0.6.0 --document docs/results/speed_commands.md
    python scripts/benchmarks/commands.py --rival ../torchbrdf-0.6.0 --only fit render --runs 1

Every command is a process, of this version and of the rival in turn, with caches of their own that are warm except
where a row says otherwise; both get the same inputs (speed/inputs.py). A row: how many times as fast it is, seconds
(medians of the runs by the clock), what is to be reached, the error of both beside it, and the largest resident memory
with what of it are pages of files. Limits "over the imports" are over a process that imports what the command does:
every module of torchbrdf and every package that it has loaded at its end. The machine's yardstick is `import torch`.

Errors: of a fit, the relative RMS difference of a rendering of its table to that of the photographed material under
the light turned by 180 degrees, of a material that no combination of the library gives; of a rendering, that to a
converged one (speed/references.py), whose own error is beside it.

--folder keeps caches, inputs, references and the rows of earlier runs: what --only leaves out comes from there. With
five runs all rows take about an hour, half of it the rival's. The rival's own hundred fits are three, times 33.
"""

import argparse
import statistics
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from speed.checkouts import Checkout, both, machine, speed_options
from speed.judging import Error, Judge, accurate
from speed.processes import Finished
from speed.rows import FAILED, Row, kept, publish, report, verdict
from speed.settings import RENDERED_UNDER
from torchbrdf.brdf import MerlTable, cell_difference
from torchbrdf.command_line import RESUMABLE, Parser, exit_status
from torchbrdf.images import read_image

FEW = 3
"""Photographs that a version without batches fits one by one, and that are judged of a batch."""

PICTURE_ERROR = 0.005

MEMORY = 1.2e9 / 2**20
"""MiB that `fit` may take, the mapped cache included."""

IMPORTED = "import {0}"
YARDSTICK = "`import torch`"

Command = list[str]


@dataclass(frozen=True)
class Work:
    """What a version does for a row: commands, one after the other; seconds count so many times.

    results  what is judged, in the folder of the run
    cache    that it begins with: "warm"; "library", expanded, without the transport; "empty"
    """

    commands: list[Command]
    results: list[str] = field(default_factory=list)
    cache: str = "warm"
    times: float = 1.0
    remark: str = ""


@dataclass(frozen=True)
class Case:
    """A row that can be measured.

    work   of a version; a text where it cannot do it
    limit  seconds to reach, of the yardsticks
    over   the row whose seconds are a yardstick
    error, memory  to reach, too; MiB
    """

    group: str
    what: str
    work: Callable[[Checkout], Work | str]
    limit: Callable[[dict[str, float]], float] | None = None
    over: str | None = None
    judge: Callable[[list[Path]], Error] | None = None
    error: float | None = None
    memory: float | None = None


@dataclass(frozen=True)
class Bench:
    """Both versions and what they work on."""

    now: Checkout
    before: Checkout
    judge: Judge

    def cases(self) -> list[Case]:
        """All rows, in the order of the table."""
        inputs, fitted = self.judge.inputs, self.judge.tables
        photograph = str(inputs.photographs[0])
        fitting = ["fit", photograph, "--probe", "default", "-o", "fitted"]
        table = str(inputs.tables["matte"])
        rendering = ["render", table, "--probe", str(inputs.probes["smooth"]), "-o", "rendered.exr"]
        found = [
            Case("yardstick", YARDSTICK, partial(importing, ["torch"])),
            Case("version", "`--version`", lambda _: Work([["--version"]])),
            Case("imports", IMPORTED.format("of `fit`"), partial(self.importing, fitting)),
            Case("imports", IMPORTED.format("of `render`"), partial(self.importing, rendering)),
            Case(
                "fit",
                "`fit`, report and table",
                lambda _: Work([fitting], ["fitted"]),
                lambda s: max(4.0, 1.5 * s[YARDSTICK] + 2),
                YARDSTICK,
                fitted,
                memory=MEMORY,
            ),
            Case(
                "no-report",
                "`fit --no-report`",
                lambda version: Work([[*fitting, "--no-report"]], ["fitted"]) if silent(version) else NO_REPORT,
                lambda s: s[IMPORTED.format("of `fit`")] + 1,
                IMPORTED.format("of `fit`"),
                fitted,
            ),
            Case("hundred", "`fit` of 100 photographs", self.hundred, lambda _: 20.0, None, fitted),
            Case("align", "`fit --align`", lambda _: Work([[*fitting, "--align"]], ["fitted"]), judge=fitted),
        ]
        for light in RENDERED_UNDER:
            for name, path in inputs.tables.items():
                command = ["render", str(path), "--probe", str(inputs.probes[light]), "-o", "rendered.exr"]
                found.append(
                    Case(
                        "render",
                        f"`render`, {name}, {light}",
                        partial(rendered, command),
                        lambda s: s[IMPORTED.format("of `render`")] + 2,
                        IMPORTED.format("of `render`"),
                        partial(picture_error, self.judge, name, light),
                        PICTURE_ERROR,
                    )
                )
        found += [
            Case("precompute", "`precompute`, orthographic", orthographic, lambda _: 20.0),
            Case("perspective", "`precompute`", perspective, lambda _: 20.0),
            Case(
                "first",
                "`fit`, first run",
                lambda _: Work([fitting], ["fitted"], "empty"),
                lambda _: 12.0,
                judge=fitted,
            ),
            Case("first", "`demo`, first run", lambda _: Work([["demo", "-o", "demo"]], [], "empty"), lambda _: 12.0),
        ]
        return found

    def importing(self, command: Command, version: Checkout) -> Work:
        """The imports of a command."""
        with tempfile.TemporaryDirectory(prefix="torchbrdf-imports-") as folder:
            version.run(["-m", "speed.imports", "--of", "modules.txt", *command], Path(folder))
            names = (Path(folder) / "modules.txt").read_text().split()
        return importing(names, version)

    def hundred(self, version: Checkout) -> Work:
        """All photographs at once, or a few one by one."""
        photographs = [str(path) for path in self.judge.inputs.photographs]
        quiet = ["--no-report"] if silent(version) else []
        if version.offers("fit", "photo ..."):
            command = ["fit", *photographs, "--probe", "default", *quiet, "-o", "fitted"]
            results = [f"fitted/{Path(path).stem}" for path in photographs[:FEW]]
            return Work([command], results, remark="in one command")
        commands = [
            ["fit", path, "--probe", "default", *quiet, "-o", f"fitted{i}"] for i, path in enumerate(photographs[:FEW])
        ]
        results = [f"fitted{i}" for i in range(FEW)]
        reports = "without reports" if quiet else "with reports"
        times = len(photographs) / FEW
        return Work(commands, results, times=times, remark=f"{FEW} commands, {reports}, times {times:.1f}")


NO_REPORT = "no `--no-report`"


def silent(version: Checkout) -> bool:
    """Whether `fit` can leave out its report."""
    return version.offers("fit", "--no-report")


def rendered(command: Command, _: Checkout) -> Work:
    """A picture."""
    return Work([command], ["rendered.exr"])


def orthographic(version: Checkout) -> Work:
    """What every version's `fit` without `--fov` needs."""
    only = ["--orthographic"] if version.offers("precompute", "--orthographic") else []
    return Work([["precompute", *only]], cache="library")


def perspective(version: Checkout) -> Work | str:
    """And what balls in perspective need."""
    if not version.offers("precompute", "--orthographic"):
        return "orthographic only"
    return Work([["precompute"]], cache="library")


def importing(names: Sequence[str], _: Checkout) -> Work:
    """Modules by their names, passed over where one cannot be imported by it."""
    return Work([["-m", "speed.imports", *names]])


def picture_error(judge: Judge, table: str, light: str, results: list[Path]) -> Error:
    """Of a rendering."""
    return judge.picture(read_image(results[0]), table, light)


def once(version: Checkout, work: Work, folder: Path) -> tuple[float, Finished]:
    """Seconds of all commands, and the process that took most memory."""
    cache = None
    if work.cache != "warm":
        cache = folder / "cache"
        cache.mkdir()
        if work.cache == "library":
            version.expanded(cache)
    done = [
        version.run(command if command[0] == "-m" else ["-m", "torchbrdf.cli", *command], folder, cache)
        for command in work.commands
    ]
    return work.times * sum(one.seconds for one in done), max(done, key=lambda one: one.peak)


def measured(bench: Bench, case: Case, runs: int, limits: dict[str, float]) -> Row:
    """Both versions in turn; what they make is judged once and then deleted."""
    works = {version: case.work(version) for version in (bench.before, bench.now)}
    able = {version: work for version, work in works.items() if isinstance(work, Work)}
    seconds: dict[Checkout, list[float]] = {version: [] for version in able}
    peaks: dict[Checkout, str] = {}
    errors: dict[Checkout, Error] = {}
    tables: dict[Checkout, MerlTable] = {}
    for run in range(runs):
        for version, work in able.items():
            with tempfile.TemporaryDirectory(prefix="torchbrdf-commands-", dir=version.cache.parent) as name:
                took, largest = once(version, work, Path(name))
                seconds[version].append(took)
                if run == 0:
                    results = [Path(name) / result for result in work.results]
                    peaks[version] = f"{largest.peak:.0f} ({largest.mapped:.0f} of files)"
                    if case.memory and version is bench.now:
                        peaks[version] += f", <= {case.memory:.0f} {verdict(largest.peak, case.memory)}"
                    if case.judge is not None:
                        errors[version] = case.judge(results)
                    if results and (results[0] / "brdf.binary").is_file():
                        tables[version] = MerlTable.open(results[0] / "brdf.binary")
    remarks = [f"{version.name}: {work}" for version, work in works.items() if isinstance(work, str)]
    remarks += [f"{version.name}: {work.remark}" for version, work in able.items() if work.remark]
    if len(tables) == 2:
        apart = cell_difference(tables[bench.now], tables[bench.before], "cube-root")
        remarks.append(f"tables differ by {100 * apart:.1g} %, cube roots")
    limit = case.limit(limits) if case.limit and (case.over is None or case.over in limits) else None
    median = {version: statistics.median(values) for version, values in seconds.items()}
    words = {version: error.words for version, error in errors.items()}
    return Row(
        case.what,
        median.get(bench.now),
        median.get(bench.before),
        limit,
        accurate(errors.get(bench.now), case.error),
        words.get(bench.now, ""),
        words.get(bench.before, ""),
        peaks.get(bench.now, ""),
        peaks.get(bench.before, ""),
        "; ".join(remarks),
        f"{bench.now.revision}, medians of {runs}",
    )


def rows(bench: Bench, groups: Sequence[str], runs: int) -> Iterator[Row]:
    """The groups that are asked for, and the yardsticks that their limits need."""
    cases, limits = bench.cases(), dict[str, float]()
    needed = {case.over for case in cases if case.group in groups} | {YARDSTICK}
    for case in cases:
        if case.group in groups or case.what in needed:
            try:
                row = measured(bench, case, runs, limits)
            except RuntimeError as error:  # the other rows are worth having
                print(error, file=sys.stderr)
                row = Row(case.what, remark=FAILED, revision=bench.now.revision)
            print(f"{row.what}: " + " | ".join(filter(None, row.cells()[1:])), file=sys.stderr, flush=True)
            if row.now is not None:
                limits[row.what] = row.now
            yield row


def run(options: argparse.Namespace) -> None:
    now, before = both(options)
    bench = Bench(now, before, Judge.of(options.folder))
    order = [case.what for case in bench.cases()]
    found = kept(options.folder / "commands.json", rows(bench, options.only, options.runs), order)
    about = f"{machine()}; {now.name} beside {before.name}, medians by the clock of processes."
    publish(report(found, about, now.name, before.name), options.document)


GROUPS = ("version", "imports", "fit", "no-report", "hundred", "align", "render", "precompute", "perspective", "first")


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--only", nargs="+", choices=GROUPS, default=GROUPS, metavar="ROWS", help=", ".join(GROUPS))
    parser.add_argument("--runs", type=int, default=5, help="of each version; default: %(default)s")
    speed_options(parser)
    return exit_status("commands", run, parser.parse_args(argv), RESUMABLE)


if __name__ == "__main__":
    sys.exit(main())
