#!/usr/bin/env python3
"""Claim: no step of a reconstruction grows faster than the pixels or the photographs that it works on.

    python scripts/benchmarks/growth.py --document docs/results/growth.md --figure docs/results/figures/growth.png
    python scripts/benchmarks/growth.py --only pixels

Time and largest resident memory of every step (speed/growing.py), each size in a process of its own: 16 x 16 to
256 x 256 pixels of a ball, 30 to 1,500 columns of a library, 1 to 1,000 photographs under one probe. The libraries
are made of the embedded materials, with other strengths and widths of their lobes. Each step's slope is that of a line
through the logarithms of its last three sizes: 1 is in proportion, 0 does not depend on it.

--folder keeps what was measured before: what --only leaves out comes from there. A quarter of an hour on two cores,
most of it for the libraries, and 5 GB of the folder meanwhile; `fit` of many photographs writes 35 MB each, deleted
after.
"""

import argparse
import json
import math
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from speed.checkouts import Checkout, machine, speed_options, this
from speed.growing import ALIGNED, MOST_PRECOMPUTED, MOST_TABLES, Point
from speed.inputs import Inputs
from speed.rows import in_words, publish
from torchbrdf.command_line import RESUMABLE, Parser, exit_status
from torchbrdf.experiments import markdown_table
from torchbrdf.files import writing

SIZES = {
    "pixels": (16, 32, 64, 128, 256),
    "columns": (10, 25, 50, 100, 250, 500),
    "photographs": (1, 3, 10, 30, 100, 300, 1000),
}
"""Of every axis: pixels along a side, materials, photographs."""

IN_PROPORTION = 1.1
"""The largest slope that counts as linear: caches of the processor overflow on the way."""

LINEAR = ("pixels", "photographs")
"""The axes along which nothing may grow faster."""

_LAST = 3
"""Sizes that the slope is taken from."""

_GUIDE = 1e-3
"""Seconds at which the dotted line of the picture begins."""

_MARKS = (500, 1000, 2000, 4000, 8000)
"""MiB that are marked in it."""

_COMMAND = "`fit` of a batch, tables on disk"


def slope(points: Sequence[Point]) -> float | None:
    """Of log seconds over log size, least squares over the largest sizes; None for fewer than two."""
    last = sorted(points, key=lambda point: point.size)[-_LAST:]
    if len(last) < 2:
        return None
    x, y = ([math.log(getattr(point, key)) for point in last] for key in ("size", "seconds"))
    mean_x, mean_y = sum(x) / len(x), sum(y) / len(y)
    covariance = sum((a - mean_x) * (b - mean_y) for a, b in zip(x, y, strict=True))
    return covariance / sum((a - mean_x) ** 2 for a in x)


def by_step(points: Iterable[Point], axis: str) -> dict[str, list[Point]]:
    """The points of an axis, by step and from the least size."""
    found: dict[str, list[Point]] = {}
    for point in sorted((point for point in points if point.axis == axis), key=lambda point: point.size):
        found.setdefault(point.step, []).append(point)
    return found


def table(steps: Mapping[str, Sequence[Point]], axis: str) -> str:
    """Seconds and MiB of every step at every size, and the slope."""
    sizes = sorted({point.size for points in steps.values() for point in points})
    rows = []
    for step, points in steps.items():
        at = {point.size: f"{in_words(point.seconds)}, {point.peak:,.0f}" for point in points}
        found = slope(points)
        rows.append([step, *(at.get(size, "") for size in sizes), "" if found is None else f"{found:.2f}"])
    return markdown_table([f"{axis}:", *(f"{size:,}" for size in sizes), "slope"], rows)


def verdict(points: Sequence[Point]) -> str:
    """What grows faster than pixels or photographs."""
    slopes = {f"{step} ({axis})": slope(some) for axis in LINEAR for step, some in by_step(points, axis).items()}
    worse = [f"{step}: {found:.2f}" for step, found in slopes.items() if found is not None and found > IN_PROPORTION]
    if not worse:
        return f"No step is worse than linear in pixels or photographs (slopes up to {IN_PROPORTION})."
    return f"**Worse than linear** in pixels or photographs: {'; '.join(worse)}."


def report(points: Sequence[Point], about: str) -> str:
    """Tables, memory and verdict in Markdown."""
    lines = [about]
    for axis in SIZES:
        steps = by_step(points, axis)
        if steps:
            lines += ["", f"## {axis.capitalize()}", "", "Time, and peak memory in MiB.", "", table(steps, axis)]
    largest = max(points, key=lambda point: point.peak)
    lines += [
        "",
        verdict(points),
        f"Largest resident memory: {largest.peak:,.0f} MiB, {largest.mapped:,.0f} of them pages of files "
        f"({largest.step}, {largest.size:,} {largest.axis}).",
        f"Libraries of more than {MOST_PRECOMPUTED} materials are not precomputed here, photographs wider than "
        f"{ALIGNED} pixels not aligned, and of a batch in Python at most {MOST_TABLES} tables are made.",
        f"Revision {', '.join(sorted({point.revision for point in points}))}.",
    ]
    return "\n".join(lines)


def draw(points: Sequence[Point], path: Path) -> None:
    """Time above memory, an axis beside the other, log-log, with a line in proportion."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    shown = [axis for axis in SIZES if any(point.axis == axis for point in points)]
    steps = dict.fromkeys(point.step for point in points)
    tones = [*range(0, 20, 2), *range(1, 20, 2)]  # the dark ones first
    colours = {step: pyplot.colormaps["tab20"](tones[i % 20]) for i, step in enumerate(steps)}
    figure, axes = pyplot.subplots(2, len(shown), figsize=(13, 8.5), sharex="col", sharey="row", squeeze=False)
    for k, axis in enumerate(shown):
        above, below = axes[:, k]
        for step, some in by_step(points, axis).items():
            found = slope(some)
            label = step.replace("`", "") + ("" if found is None else f" ({found:.2f})")
            for panel, key in ((above, "seconds"), (below, "peak")):
                values = [getattr(point, key) for point in some]
                panel.plot([point.size for point in some], values, "o-", ms=4, color=colours[step], label=label)
        sizes = sorted({point.size for point in points if point.axis == axis})
        ends = [sizes[0], sizes[-1]]
        above.plot(ends, [_GUIDE * size / ends[0] for size in ends], ":", color="0.5", label="in proportion (1)")
        above.set(xscale="log", yscale="log")
        below.set(xlabel=axis, xscale="log", yscale="log")
        below.set_xticks(sizes, [f"{size:,}" for size in sizes])
        below.set_xticks([], minor=True)
        below.set_yticks(_MARKS, [f"{mark:,}" for mark in _MARKS])
        below.set_yticks([], minor=True)
        for panel in (above, below):
            panel.grid(alpha=0.25)
        below.legend(*above.get_legend_handles_labels(), fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.16))
    axes[0, 0].set_ylabel("seconds")
    axes[1, 0].set_ylabel("peak resident memory, MiB")
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    with writing(path) as temporary:
        figure.savefig(temporary, dpi=110)


def measured(version: Checkout, axis: str, size: int, inputs: Inputs, folder: Path) -> Iterator[Point]:
    """The steps of one size."""
    with tempfile.TemporaryDirectory(prefix="torchbrdf-growth-", dir=folder) as work:
        output = Path(work) / "points.json"
        version.run(["-m", "speed.growing", axis, str(size), str(inputs.folder), work, str(output)], Path(work))
        yield from (Point(**point) for point in json.loads(output.read_text()))
        photographs = [str(path) for path in inputs.photographs[:size]]
        if axis == "photographs" and len(photographs) == size and version.offers("fit", "photo ..."):
            command = ["-m", "torchbrdf.cli", "fit", *photographs, "--probe", "default", "--no-report", "-o", "fitted"]
            done = version.run(command, Path(work))
            yield Point(axis, _COMMAND, size, done.seconds, done.peak, done.mapped)


def of_record(record: dict[str, Any]) -> Point:
    return Point(**record)


def key(point: Point) -> tuple[str, str, int]:
    """Of which there is one point."""
    return point.axis, point.step, point.size


def run(options: argparse.Namespace) -> None:
    folder, version = options.folder, this(options)
    inputs, kept = Inputs.of(folder), folder / "growth.json"
    known = {key(point): point for point in map(of_record, json.loads(kept.read_text()) if kept.is_file() else [])}
    failed: list[str] = []
    for axis in options.only:
        if not options.sizes:
            known = {place: point for place, point in known.items() if point.axis != axis}
        for size in [size for size in SIZES[axis] if size in (options.sizes or SIZES[axis])]:
            try:
                for point in measured(version, axis, size, inputs, folder):
                    print(f"{axis} {point.size}, {point.step}: {in_words(point.seconds)}, {point.peak:.0f} MiB",
                          file=sys.stderr, flush=True)  # fmt: skip
                    known[key(point)] = replace(point, revision=version.revision)
            except RuntimeError as error:  # the other sizes are worth having
                print(error, file=sys.stderr)
                failed.append(f"\n**Failed**: {axis}, {size}.")
            with writing(kept) as temporary:
                temporary.write_text(json.dumps([asdict(point) for point in known.values()], indent=1) + "\n")
    points = list(known.values())
    if options.figure:
        draw(points, options.figure)
    publish(report(points, f"{machine()}; {version.name}.") + "".join(failed), options.document)


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--only", nargs="+", choices=SIZES, default=list(SIZES), metavar="AXIS", help=", ".join(SIZES))
    parser.add_argument("--sizes", nargs="+", type=int, help="only these: pixels across, materials, photographs")
    parser.add_argument("--figure", type=Path, help="draw time and memory, log-log")
    speed_options(parser, rival=False)
    return exit_status("growth", run, parser.parse_args(argv), RESUMABLE)


if __name__ == "__main__":
    sys.exit(main())
