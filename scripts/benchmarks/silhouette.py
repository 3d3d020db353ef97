#!/usr/bin/env python3
"""How well `tb.align` finds the silhouette of a ball beside the rotation of its probe: the table of docs/alignment.md.

    python scripts/make_targets.py --measured ../shared/data/rgl --size 768 --samples 16 --max-samples 64 -o fine
    python scripts/benchmarks/silhouette.py --renderings fine --library merl --observed ennis venice -o OUT

Mitsuba renders each material at 768 x 768; averaged to a ball of 192 pixels, before the light around it and with noise,
that is a photograph. Its silhouette is guessed wrongly, moved in a random direction or grown by pixels of the 64 that
are fitted, under the probe as it is or turned. The error is that of the re-rendering under all other probes: with the
true silhouette and probe, with the guess, and with what was found.

OUT holds one file a finished case: run the same command again to continue.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import mean, median
from typing import Any

from silhouette_cases import ACROSS, FINER, silhouette_case
from torchbrdf.command_line import RESUMABLE, Parser, exit_status
from torchbrdf.experiments import SHARED, SweepInputs, markdown_table, read_targets, sweep_options
from torchbrdf.files import writing
from torchbrdf.sweep import Task, sweep

GUESSES: dict[str, tuple[float, float, float]] = {
    "right": (0, 0, 0),
    "shifted by 0.25 pixel of 64": (0.25, 0, 0),
    "by 0.5": (0.5, 0, 0),
    "by 1": (1, 0, 0),
    "radius 1 % too large": (0, 0.32, 0),
    "1 % too small": (0, -0.32, 0),
    "2 % too large": (0, 0.64, 0),
    "shifted by 1.5, radius 1.5 % too large": (1.5, 0.48, 0),
    "shifted by 1.2, radius 2 % too small": (1.2, -0.64, 0),
    "shifted by 1.9": (1.9, 0, 0),
    "right, probe turned by 2 degrees": (0, 0, 2),
    "shifted by 1, probe turned by 2 degrees": (1, 0, 2),
    "shifted by 1.5, radius 1.5 % too large, probe turned by 2 degrees": (1.5, 0.48, 2),
}
"""Pixels of 64 by which a guess is moved and grown, and degrees by which the probe is turned."""

Rows = Sequence[Mapping[str, Any]]


def line(name: str, rows: Rows) -> list[str]:
    """One line of the table."""
    ideal, before, after = (100 * mean(row[key] for row in rows) for key in ("ideal", "before", "after"))
    off = [max(abs(row[key]) for key in ("x", "y", "radius")) for row in rows]
    return [
        name,
        str(len(rows)),
        f"{ideal:.2f}",
        f"{before:.2f}",
        f"{after:.2f}",
        f"{after / ideal:.2f}",
        f"{max(row['after'] / row['ideal'] for row in rows):.2f}",
        f"{median(off):.2f}",
        f"{max(off):.2f}",
        f"{median(row['std'] for row in rows):.2f}",
        f"{sum(row['moved'] for row in rows):.0f}",
        f"{median(row['left'] for row in rows):.2f}",
    ]


def report(rows: Rows) -> str:
    """The table in Markdown, and what it cost."""
    head = [
        "first guess", "cases", "ideal, %", "with the guess", "found", "found / ideal", "worst", "off, pixels: median",
        "largest", "standard deviation", "moved", "left, degrees",
    ]  # fmt: skip
    lines = [line(name, some) for name in GUESSES if (some := [row for row in rows if row["guess"] == name])]
    cost = (
        f"\nSeconds: median {median(row['seconds'] for row in rows):.1f}, of one processor "
        f"{median(row['cpu'] for row in rows):.1f}; rotations {median(row['evaluations'] for row in rows):.0f}."
    )
    return "\n".join([markdown_table(head, [*lines, line("all", rows)]), cost])


def run(options: argparse.Namespace) -> int:
    targets = read_targets(options.renderings)
    if targets[0].size != FINER * ACROSS:
        raise ValueError(f"{options.renderings}: {targets[0].size} pixels; make them with --size {FINER * ACROSS}")
    inputs = SweepInputs.open(options.library, options.probes, {target.probe for target in targets})
    places = {**inputs.places, "renderings": str(options.renderings.resolve())}
    tasks, about = [], []
    chosen = [target for target in targets if not options.observed or target.probe in options.observed]
    chosen = [target for target in chosen if not options.materials or target.material in options.materials]
    for seed, target in enumerate(chosen):
        for i, (guess, (moved, grown, turned)) in enumerate(GUESSES.items()):
            if (seed + i) % options.every == 0:
                arguments = {
                    "library": inputs.library.source,
                    "probes": inputs.probes,
                    "observed": target.probe,
                    "material": target.material,
                    "off": (moved, grown),
                    "turned": turned,
                    "noise": options.noise,
                    "seed": seed,
                }
                tasks.append(Task(f"{target.probe}-{target.material}-{i}", arguments, places))
                about.append({"guess": guess, "probe": target.probe, "material": target.material})
    found = sweep(silhouette_case, tasks, options.output / "cases", options.processes, options.scheduler, "silhouettes")
    table = report([{**what, **found[task.name]} for what, task in zip(about, tasks, strict=True)])
    with writing(options.output / "silhouette.md") as path:
        path.write_text(table + "\n")
    print(table)
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--renderings", type=Path, required=True, help="folder of targets made with --size 768")
    parser.add_argument("--observed", nargs="+", metavar="PROBE", help="only photographs under these")
    parser.add_argument("--materials", nargs="+", metavar="NAME", help="only these of them")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="one of so many cases; default: 1")
    parser.add_argument("--probes", type=Path, default=SHARED / "probes", help="folder of the probes")
    parser.add_argument("--library", type=Path, help="folder of MERL tables; default: the embedded library")
    parser.add_argument("--noise", type=float, default=1.0, help="of a pixel, in per cent; default: 1")
    sweep_options(parser)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the cases and silhouette.md")
    return exit_status("silhouette", run, parser.parse_args(argv), RESUMABLE)


if __name__ == "__main__":
    sys.exit(main())
