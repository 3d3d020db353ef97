#!/usr/bin/env python3
"""Claim: what the commands make of photographs is as good as what they make of the ideal observation.

    python scripts/make_captures.py --set report -o captures/report
    python scripts/benchmarks/capture.py captures/report -o OUT

Runs `torchbrdf merge`, `probe` and `fit` as processes on the files of every capture, with nothing by hand, and shows
the tables under all lights but the capture's own: error = |rendered - target| / |target| over the pixels of 64 x 64,
mean over the lights, in per cent. Beside it the ratio to the ideal observation of the same captures, the time of all
commands, how often one refused, and silent failures: errors of at least twice the ideal's without a line of warning,
and those whose warnings the ideal observation gave, too. Stages whose commands this torchbrdf lacks are not available.
With --by-hand the circles of all balls are given from the truth.

OUT holds one file a finished case: run the same command again to continue.
"""

import argparse
import json
import re
import statistics
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torchbrdf as tb
from capture_stages import IDEAL, Stage, capture_case, code_of_package, is_available, stages
from torchbrdf.command_line import RESUMABLE, Parser, exit_status
from torchbrdf.experiments import markdown_table, percent, relatives, sweep_options
from torchbrdf.files import writing
from torchbrdf.sweep import Task, sweep

SILENT = 2.0
"""Times the ideal's error, from which on a result without a warning is a silent failure."""

_NUMBER = re.compile(r"\d+(\.\d+)?")

Cases = Mapping[str, Mapping[str, Any]]
"""Capture -> what `capture_case` returns."""

HEAD = [
    "files", "captures", "mean", "median", "worst", "over ideal: mean", "worst", "refused", "at least 2 x ideal",
    "silent", "as silent as the ideal", "seconds: median", "most",
]  # fmt: skip


def truths_of(folder: Path, only: Sequence[str] = ()) -> dict[str, dict[str, Any]]:
    """The captures of a folder by name. Raises FileNotFoundError where there are none, or no targets of one."""
    found = {path.parent.name: json.loads(path.read_text()) for path in sorted(folder.glob("[!.]*/truth.json"))}
    if not found:
        raise FileNotFoundError(f"{folder}: no captures here; make them with scripts/make_captures.py -o {folder}")
    unknown = [name for name in only if name not in found]
    if unknown:
        raise ValueError(f"--only {unknown[0]}: there are {', '.join(found)}")
    found = {name: found[name] for name in only or found}
    for name, truth in found.items():
        if not list(folder.glob(f"targets/*/{truth['material']}.exr")):
            raise FileNotFoundError(
                f"{folder}: no targets of {truth['material']}, which {name} shows; make them with "
                f"scripts/make_captures.py -o {folder}, without --no-targets"
            )
    return found


def silent(case: Mapping[str, Any], ideal: Mapping[str, Any]) -> bool:
    """Whether a case is bad and nothing was said."""
    return failed(case, ideal) and not case["warnings"]


def says_no_more(case: Mapping[str, Any], ideal: Mapping[str, Any]) -> bool:
    """Whether a case is bad and every warning of it, numbers aside, came with the ideal observation, too."""
    kinds, usual = ({_NUMBER.sub("", warning) for warning in one["warnings"]} for one in (case, ideal))
    return failed(case, ideal) and kinds <= usual


def failed(case: Mapping[str, Any], ideal: Mapping[str, Any]) -> bool:
    """Whether a case has SILENT times the error of the ideal observation."""
    return bool(case["error"] is not None and ideal["error"] is not None and case["error"] >= SILENT * ideal["error"])


def line(name: str, cases: Cases, ideal: Cases) -> list[str]:
    """A row of the table."""
    refused = sum(case["message"] is not None for case in cases.values())
    errors = {key: case["error"] for key, case in cases.items() if case["error"] is not None}
    seconds = [case["seconds"] for case in cases.values()]
    numbers = [""] * 5
    if errors:
        values = list(errors.values())
        numbers[:3] = [percent(value) for value in (statistics.mean(values), statistics.median(values), max(values))]
        ratios = {key: (errors[key], ideal[key]["error"]) for key in errors if ideal.get(key, {}).get("error")}
        if ratios:
            got, best = (statistics.mean(pair[i] for pair in ratios.values()) for i in range(2))
            numbers[3:] = [f"{got / best:.2f}", f"{max(one / other for one, other in ratios.values()):.2f}"]
    pairs = [(case, ideal[key]) for key, case in cases.items() if key in ideal]
    return [
        name,
        str(len(cases)),
        *numbers,
        str(refused),
        str(sum(failed(*pair) for pair in pairs)),
        str(sum(silent(*pair) for pair in pairs)),
        str(sum(says_no_more(*pair) for pair in pairs)),
        f"{statistics.median(seconds):.1f}",
        f"{max(seconds):.1f}",
    ]


def report(found: Mapping[str, Cases], absent: Sequence[Stage]) -> str:
    """The table by defect, then every capture, then what was said of refusals and failures."""
    ideal = found.get(IDEAL, {})
    rows = [line(name, cases, ideal) for name, cases in found.items()]
    rows += [[stage.name, "not available", *[""] * (len(HEAD) - 2)] for stage in absent]
    captures = list(dict.fromkeys(key for cases in found.values() for key in cases))
    each = [[key, *(_cell(cases[key], ideal.get(key)) for cases in found.values())] for key in captures]
    said = [
        f"- {name}, {key}: {case['message'] or '; '.join(case['warnings']) or 'nothing was said'}"
        for name, cases in found.items()
        for key, case in cases.items()
        if case["message"] is not None or (key in ideal and failed(case, ideal[key]))
    ]
    parts = [markdown_table(HEAD, rows), markdown_table(["capture", *found], each)]
    if said:
        parts.append("Refusals, and what was said where the error is at least twice the ideal's:\n\n" + "\n".join(said))
    return "\n\n".join(parts)


def _cell(case: Mapping[str, Any], ideal: Mapping[str, Any] | None) -> str:
    if case["error"] is None:
        return "refused"
    return percent(case["error"]) + (" silent" if ideal is not None and silent(case, ideal) else "")


def run(options: argparse.Namespace) -> None:
    truths = truths_of(options.captures, options.only)
    chosen = stages(options.by_hand)
    if options.stages:
        chosen = [stage for stage in chosen if any(text in stage.name for text in options.stages)]
        if not chosen:
            known = "; ".join(stage.name for stage in stages(options.by_hand))
            raise ValueError(f"--stages: none holds {options.stages[0]!r}; there are {known}")
    ready = [stage for stage in chosen if all(is_available(need) for need in stage.needs)]
    library = tb.MaterialLibrary.from_files(options.library or "default")
    given = [] if options.library is None else ["--library", str(options.library.resolve())]
    common = {"by_hand": options.by_hand, "code": code_of_package()}

    def options_of(material: str) -> list[str]:
        return given + [word for name in relatives(material, library.names) for word in ("--without", name)]

    tasks = [
        Task(
            f"{name}-{stage.name.replace(' ', '_')}",
            common | {"stage": stage.name, "truth": truth, "options": options_of(truth["material"])},
            {"captures": str(options.captures.resolve())},
        )
        for name, truth in truths.items()
        for stage in ready
    ]
    results = sweep(capture_case, tasks, options.output / "cases", options.processes, options.scheduler, "cases")
    found: dict[str, dict[str, Any]] = {stage.name: {} for stage in ready}
    for task in tasks:
        found[task.arguments["stage"]][task.arguments["truth"]["plan"]["name"]] = results[task.name]
    text = report(found, [stage for stage in chosen if stage not in ready])
    with writing(options.output / "capture.md") as path:
        path.write_text(text + "\n")
    print(text)


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("captures", type=Path, help="folder that make_captures.py wrote")
    parser.add_argument("--only", nargs="+", default=(), metavar="NAME", help="these captures; default: all")
    parser.add_argument("--stages", nargs="+", metavar="TEXT", help="whose names hold one of these texts; default: all")
    parser.add_argument("--by-hand", action="store_true", help="give the circles of all balls, from the truth")
    parser.add_argument("--library", type=Path, help="folder of MERL tables; default: the embedded library")
    sweep_options(parser)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the cases and capture.md")
    return exit_status("capture", run, parser.parse_args(argv), RESUMABLE)


if __name__ == "__main__":
    sys.exit(main())
