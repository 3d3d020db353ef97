#!/usr/bin/env python3
"""Claim: whatever a file holds, reading it ends within 5 s, in a result or in one line that names it, in little memory.

    python scripts/benchmarks/fuzz_readers.py                          # 100,000 mutated inputs a reader
    python scripts/benchmarks/fuzz_readers.py --reader exr --first 40000 --inputs 1000
    python scripts/benchmarks/fuzz_readers.py fuzz-findings/*          # files once found, as they are

Sound files of every flavour are made, read, and then mutated: bits, bytes, telling numbers, chunks, splices of two files,
and what the format knows (header lines, chunks with their checksums, attributes, words, entries of JSON). A worker reads
one after another; findings are: a crash, a hang (twice more than 5 s), address space of more than 4 times the file and
64 MiB asked for, an error other than ValueError and OSError, and a message that names no file or is not one printable
line. Exit status: 0 without findings, 1 with, 2 where it could not run, 130 after Ctrl-C.

An input is the same for the same reader, seed, number, and versions of this script and of the libraries that write the
sound files, so runs may be cut in pieces: --first 0 --inputs 50000, then --first 50000. Linux only.
"""

import argparse
import shlex
import sys
from pathlib import Path

from tqdm import tqdm

from fuzzing.campaign import PATIENCE, Finding, Tally, run
from fuzzing.files import InputFile
from fuzzing.reading import CONSTANT, TIMES_FILE
from fuzzing.readers import READERS, Reader
from fuzzing.worker import Share
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.experiments import markdown_table

SHARE = 5000
"""Inputs that a worker reads before another one starts."""

FOUND = 1
_EXAMPLES = 3
_LONGEST_SAVED = 64 << 20


def fuzz(options: argparse.Namespace, source: str = "fuzzing.readers") -> int:
    """Run what the options ask for, print the table; returns the exit status."""
    if sys.platform != "linux":
        raise ValueError("fuzzing watches its workers through /proc, which only Linux has; run it there")
    seeds = {name: Reader.named(source, name).seeds() for name in options.reader}
    if options.files:
        given = [_given(path) for path in options.files]
        suffixes = {name: {seed.suffix for seed in files} for name, files in seeds.items()}
        seeds = {name: [one for one in given if one.suffix in suffixes[name]] for name in seeds}
        seeds = {name: files for name, files in seeds.items() if files}
        if unknown := [one.name for one in given if not any(one.suffix in suffixes[name] for name in seeds)]:
            raise ValueError(f"{unknown[0]}: no reader chosen here takes such a file; the readers: {', '.join(READERS)}")
    sound = {name: Tally() for name in seeds}
    tallies = {name: Tally() for name in seeds}
    try:
        shares = [Share.of_seeds(source, name, files) for name, files in seeds.items()]
        _run("sound files", shares, sound, options)
        if not options.files:
            read = [name for name, tally in sound.items() if tally.accepted or tally.findings]
            _run("mutated", [share for name in read for share in _shares(source, name, seeds, options)], tallies, options)
    finally:
        findings = [finding for tally in (*sound.values(), *tallies.values()) for finding in tally.findings]
        _print_table(sound, {} if options.files else tallies)
        if findings:
            _print_findings(findings, options)
    return FOUND if findings else 0


def _shares(source: str, name: str, seeds: dict[str, list[InputFile]], options: argparse.Namespace) -> list[Share]:
    end = options.first + options.inputs
    return [
        Share(source, name, seeds[name], options.seed, first, min(SHARE, end - first))
        for first in range(options.first, end, SHARE)
    ]


def _run(what: str, shares: list[Share], tallies: dict[str, Tally], options: argparse.Namespace) -> None:
    with tqdm(total=sum(share.count for share in shares), desc=what, unit="", disable=options.quiet) as bar:

        def advanced(count: int) -> None:
            bar.update(count)
            bar.set_postfix(findings=sum(len(tally.findings) for tally in tallies.values()), refresh=False)

        run(shares, tallies, options.processes, options.patience, advanced)


def _given(path: Path) -> InputFile:
    """A file as it is, of which what follows the first 64 MiB is taken to be zeros."""
    with open(path, "rb") as file:
        return InputFile(str(path), path.suffix, file.read(_LONGEST_SAVED), path.stat().st_size)


def _print_table(sound: dict[str, Tally], mutated: dict[str, Tally]) -> None:
    rows = []
    for name, seeds in sound.items():
        tally = mutated.get(name, seeds)
        if not (tally.inputs or seeds.accepted or seeds.findings):
            rows.append([f"{name} (not read by this version)", "0", *["-"] * 6])
            continue
        shown = [f"{1000 * tally.seconds / max(tally.inputs, 1):.2f}", f"{1000 * tally.slowest:.0f}", f"{tally.memory / 2**20:.0f}"]
        refused = tally.inputs - tally.accepted
        findings = len(seeds.findings) + (len(tally.findings) if tally is not seeds else 0)
        rows.append([name, f"{tally.inputs:,}", f"{tally.accepted:,}", f"{refused:,}", *shown, f"{findings:,}"])
    memory = f"most memory over {TIMES_FILE} x the file, MiB (bound {CONSTANT >> 20})"
    print(markdown_table(["reader", "inputs", "accepted", "refused", "mean, ms", "slowest, ms", memory, "findings"], rows))


def _print_findings(findings: list[Finding], options: argparse.Namespace) -> None:
    """One paragraph a fault, with the smallest inputs that show it, saved."""
    folder: Path = options.output
    folder.mkdir(parents=True, exist_ok=True)
    kinds: dict[tuple[str, str, str], list[Finding]] = {}
    for finding in findings:
        kinds.setdefault(finding.signature, []).append(finding)
    command = None
    for (reader, kind, where), same in kinds.items():
        same.sort(key=lambda finding: finding.share.input(finding.index)[0].size)
        print(f"\n{reader}: {kind}, {len(same)} times{f', {where}' if where else ''}: {same[0].problem.message}")
        for finding in same[:_EXAMPLES]:
            file, entry = finding.share.input(finding.index)
            seed = "seed" if finding.share.seed is None else finding.share.seed
            saved = Path(file.name) if options.files else folder / f"{reader}-{seed}-{finding.index}{file.suffix}"
            if not options.files:
                file.write(saved)
            print(f"    {saved}: {file.size} bytes, from {file.name!r}, {entry}")
            command = command or f"{sys.argv[0]} {shlex.quote(str(saved))}"
            if finding.share.seed is not None:
                again = f"--reader {reader} --seed {seed} --first {finding.index} --inputs 1"
                print(f"        python scripts/benchmarks/fuzz_readers.py {again}")
    print(f"\nThe first of them once more: python {command}")


def parser() -> Parser:
    """Of the command line."""
    made = Parser.of_script(__doc__)
    made.add_argument("files", nargs="*", type=Path, help="read these as they are, by every entry, and mutate nothing")
    made.add_argument("--reader", nargs="+", choices=READERS, default=list(READERS), help="default: all", metavar="NAME")
    made.add_argument("--inputs", type=int, default=100_000, help="mutated inputs a reader; default: 100000")
    made.add_argument("--first", type=int, default=0, help="number of the first; default: 0")
    made.add_argument("--seed", type=int, default=0, help="of the mutations; default: 0")
    made.add_argument("--processes", type=int, default=1, help="workers at once; default: 1")
    made.add_argument("--patience", type=float, default=PATIENCE, help=f"seconds before a hang; default: {PATIENCE:g}")
    made.add_argument("--output", type=Path, default=Path("fuzz-findings"), help="of findings; default: fuzz-findings")
    made.add_argument("--quiet", action="store_true", help="no progress")
    return made


def main() -> int:
    options = parser().parse_args()
    message = f"interrupted; the table above holds what was read; --first {options.first} starts again"
    return exit_status("fuzz_readers", fuzz, options, message)


if __name__ == "__main__":
    sys.exit(main())
