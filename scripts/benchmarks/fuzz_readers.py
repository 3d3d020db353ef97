#!/usr/bin/env python3
"""Claim: whatever a file holds, reading it ends within 5 s, in a result or in one line that names it, in little memory.

    python scripts/benchmarks/fuzz_readers.py --processes 2            # 100,000 mutated inputs a reader
    python scripts/benchmarks/fuzz_readers.py --reader exr png --first 40000 --inputs 1000
    python scripts/benchmarks/fuzz_readers.py fuzz-findings/*          # files once found, as they are

Sound files of every flavour are made, read, and then mutated: bits, bytes, telling numbers, chunks, splices of two
files, and what the format knows (header lines, chunks with their checksums, attributes, words, entries of JSON). A
worker reads one after another. Findings are: a crash; a hang, more than 5 s twice; address space asked for beyond 4
times the file and 192 MiB, for light probes 384; an error other than ValueError and OSError; a message that names no
file or is not one printable line; a result that cannot be. Exit status: 0 without findings, 1 with, 2 where it could
not run, 130 after Ctrl-C.

An input is the same for the same reader, seed, number, and versions of this script and of the libraries that write the
sound files: runs may be cut in pieces, --inputs 50000 and then --first 50000 --inputs 50000. Linux only.
"""

import argparse
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

import torchbrdf
from fuzzing.campaign import PATIENCE, Finding, Tally, run
from fuzzing.files import InputFile
from fuzzing.readers import PROBE_CONSTANT, READERS, Reader
from fuzzing.reading import CONSTANT, TIMES_FILE
from fuzzing.worker import Share
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.experiments import markdown_table

FOUND = 1
"""Exit status."""

_SHARE = 20_000
_EXAMPLES = 3
_LONGEST_GIVEN = 64 << 20
_SCRIPT = "python scripts/benchmarks/fuzz_readers.py"

Seeds = Mapping[str, Sequence[InputFile]]


def fuzz(options: argparse.Namespace) -> int:
    """Read what the options ask for and print what came of it; returns the exit status."""
    if sys.platform != "linux":
        raise ValueError("workers are watched through /proc, which only Linux has; run this on Linux")
    if min(options.inputs, options.processes) < 1 or options.first < 0:
        raise ValueError("--inputs and --processes must be at least 1, and --first at least 0")
    print(f"torchbrdf {torchbrdf.__version__} of {Path(torchbrdf.__file__).parent}\n")
    seeds: Seeds = {name: Reader.named(options.source, name).seeds() for name in options.reader}
    if options.files:
        seeds = _given(options.files, seeds)
    sound, mutated = ({name: Tally() for name in seeds} for _ in range(2))
    try:
        shares = [Share.of_seeds(options.source, name, files) for name, files in seeds.items()]
        _run("files as they are", shares, sound, options)
        if not options.files:
            read = {name: seeds[name] for name, tally in sound.items() if tally.accepted or tally.findings}
            _run("mutated files", _shares(read, options), mutated, options)
    finally:
        findings = [finding for tally in (*sound.values(), *mutated.values()) for finding in tally.findings]
        _print_table(sound, mutated)
        _print_findings(findings, options)
    return FOUND if findings else 0


def _given(paths: Sequence[Path], seeds: Seeds) -> Seeds:
    """The files by the readers that take such; zeros are taken to follow the first 64 MiB."""
    given: dict[str, list[InputFile]] = {}
    for path in paths:
        with open(path, "rb") as file:
            found = InputFile(str(path), path.suffix, file.read(_LONGEST_GIVEN), path.stat().st_size)
        names = [name for name, files in seeds.items() if path.suffix in {seed.suffix for seed in files}]
        if not names:
            raise ValueError(f"{path}: no reader takes such a file; those chosen are {', '.join(seeds)}")
        for name in names:
            given.setdefault(name, []).append(found)
    return given


def _shares(seeds: Seeds, options: argparse.Namespace) -> list[Share]:
    """What workers do one after another: at most _SHARE inputs of a reader."""
    end = options.first + options.inputs
    return [
        Share(options.source, name, files, options.seed, first, min(_SHARE, end - first))
        for name, files in seeds.items()
        for first in range(options.first, end, _SHARE)
    ]


def _run(what: str, shares: list[Share], tallies: dict[str, Tally], options: argparse.Namespace) -> None:
    with tqdm(total=sum(share.count for share in shares), desc=what, unit="", disable=options.quiet) as bar:

        def advanced(count: int) -> None:
            bar.set_postfix(findings=sum(len(tally.findings) for tally in tallies.values()), refresh=False)
            bar.update(count)

        run(shares, tallies, options.processes, options.patience, advanced)


def _print_table(sound: Mapping[str, Tally], mutated: Mapping[str, Tally]) -> None:
    rows = []
    for name, seeds in sound.items():
        tally = mutated[name]
        cells = [name, f"{seeds.accepted} of {seeds.inputs}"]
        if tally.inputs:
            cells += [f"{tally.inputs:,}", f"{tally.accepted:,}", f"{tally.inputs - tally.accepted:,}"]
            cells += [f"{1000 * tally.seconds / tally.inputs:.2f}", f"{1000 * tally.slowest:.0f}"]
            cells += [f"{tally.memory / 2**20:.0f}"]
        else:
            cells += ["-"] * 6
        rows.append([*cells, f"{len(seeds.findings) + len(tally.findings):,}"])
    memory = f"memory over {TIMES_FILE} x the file, at most {CONSTANT >> 20} MiB ({PROBE_CONSTANT >> 20} for probes)"
    head = [
        "reader",
        "as they are, accepted",
        "mutated",
        "accepted",
        "refused",
        "mean, ms",
        "slowest, ms",
        memory,
        "findings",
    ]
    print(markdown_table(head, rows))


def _print_findings(findings: Sequence[Finding], options: argparse.Namespace) -> None:
    """A paragraph for each fault, with the smallest inputs that show it, saved."""
    faults: dict[tuple[str, str, str], list[Finding]] = {}
    for finding in findings:
        faults.setdefault(finding.signature, []).append(finding)
    again = ""
    for (reader, kind, where), same in faults.items():
        same.sort(key=_smallest_first)
        message = same[0].problem.message
        print(f"\n{reader}: {kind}, {len(same)} inputs{f', {where}' if where else ''}: {message}")
        for finding in same[:_EXAMPLES]:
            file, entry = finding.share.input(finding.index)
            saved = Path(file.name)
            how = "as it is"
            if not options.files:
                number = "sound" if finding.share.seed is None else finding.share.seed
                saved = options.output / f"{reader}-{number}-{finding.index}{file.suffix}"
                options.output.mkdir(parents=True, exist_ok=True)
                file.write(saved)
                how = f"from {file.name!r}"
            if finding.share.seed is not None:
                how += f", --reader {reader} --seed {finding.share.seed} --first {finding.index} --inputs 1"
            print(f"    {saved}: {file.size} bytes, {entry}, {how}")
            again = again or f"{_SCRIPT} {shlex.quote(str(saved))} --reader {reader}"
    if again:
        print(f"\nThe first once more: {again}")


def _smallest_first(finding: Finding) -> tuple[int, bool, int]:
    """The same order however many workers found them."""
    file, _ = finding.share.input(finding.index)
    return file.size, finding.share.seed is not None, finding.index


def parser() -> Parser:
    """Of the command line."""
    made = Parser.of_script(__doc__)
    made.set_defaults(source="fuzzing.readers")
    made.add_argument("files", nargs="*", type=Path, help="read these as they are, by every entry; mutate nothing")
    made.add_argument(
        "--reader",
        nargs="+",
        choices=tuple(READERS),
        default=tuple(READERS),
        metavar="NAME",
        help=f"of {', '.join(READERS)}; default: all",
    )
    made.add_argument("--inputs", type=int, default=100_000, help="mutated files a reader; default: 100000")
    made.add_argument("--first", type=int, default=0, help="number of the first of them; default: 0")
    made.add_argument("--seed", type=int, default=0, help="of the mutations; default: 0")
    made.add_argument("--processes", type=int, default=1, help="workers at once; default: 1")
    made.add_argument("--patience", type=float, default=PATIENCE, help=f"seconds; default: {PATIENCE:g}")
    made.add_argument("--output", type=Path, default=Path("fuzz-findings"), help="folder; default: fuzz-findings")
    made.add_argument("--quiet", action="store_true", help="show no progress")
    return made


def main() -> int:
    options = parser().parse_args()
    return exit_status("fuzz_readers", fuzz, options, "interrupted; the table counts what was read")


if __name__ == "__main__":
    sys.exit(main())
