#!/usr/bin/env python3
"""Our analytic fits beside those published by [NDM05] and [LKYU12]: the table of docs/results/published_fits.md.

    python scripts/benchmarks/published_fits.py --library merl -o OUT

Both are judged by the same metrics on the same tables of MERL's materials; ours are fitted anew for every metric.

OUT holds one file a finished case: run the same command again to continue.
"""

import argparse
import hashlib
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import torchbrdf as tb
from published_cases import compare_case
from published_fit_files import FITS, published_files, read_published
from torchbrdf.brdf import METRICS
from torchbrdf.command_line import RESUMABLE, Parser, exit_status
from torchbrdf.experiments import sweep_options
from torchbrdf.files import writing
from torchbrdf.sweep import Task, sweep


def fitted_in(name: str) -> str:
    """The metric for which a file was fitted: [NDM05] and E1 of [LKYU12] are L2, E2 is the logarithm."""
    return "log" if name.endswith("_E2") else "l2"


def line(name: str, model: str | None, metric: str, pairs: Mapping[str, tuple[float, float | None]]) -> str:
    """One line of the table; pairs: material -> published, ours."""
    theirs = median([published for published, _ in pairs.values()])
    own = ", its own" if metric == fitted_in(name) else ""
    start = f"| {name} | {model or 'not ours'} | {len(pairs)} | {metric}{own} | {theirs:.3f} |"
    ours = {name: (one, published) for name, (published, one) in pairs.items() if one is not None}
    if not ours:
        return f"{start} | | |"
    ratios = {name: one / published for name, (one, published) in ours.items()}
    worst = max(ratios, key=lambda name: ratios[name])
    won = sum(ratio <= 1.001 for ratio in ratios.values())
    return f"{start} {median([one for one, _ in ours.values()]):.3f} | {won} | {ratios[worst]:.2f} ({worst}) |"


def run(options: argparse.Namespace) -> int:
    library = tb.MaterialLibrary.from_merl(options.library)
    files = published_files(options.fits)
    places = {"library_path": str(options.library.resolve()), "fits": str(options.fits.resolve())}
    published = {name: read_published(path) for name, path in files.items()}
    lobes = {name: next(iter(fits.values())) for name, fits in published.items()}
    groups: dict[str, list[str]] = {}
    for name, fit in lobes.items():  # ours of one model serve all files of it
        groups.setdefault(fit.model or fit.lobe, []).append(name)
    digests = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files.values()}
    tasks = {
        (group, material): Task(
            f"{group}-{material}",
            {
                "library": library.source,
                "material": material,
                "files": {files[name].name: digests[files[name].name] for name in names},
            },
            places,
        )
        for group, names in groups.items()
        for material in published[names[0]]
        if material in library.names
    }
    found = sweep(
        compare_case, list(tasks.values()), options.output / "cases", options.processes, options.scheduler, "fits"
    )
    head = "| file | model | materials | metric | published, median | ours, median | ours as good in | ours worst by |"
    lines = [head, "|---|---|---:|---|---:|---:|---:|---:|"]
    failed: list[Any] = []
    for group, names in groups.items():
        rows = {material: found[task.name] for (one, material), task in tasks.items() if one == group}
        for name in names:
            for metric in METRICS:
                pairs = {
                    material: (row[metric]["published"][files[name].name], row[metric]["ours"])
                    for material, row in rows.items()
                }
                lines.append(line(name, lobes[name].model, metric, pairs))
        failed += [
            (group, material, metric)
            for metric in METRICS
            for material, row in rows.items()
            if row[metric]["converged"] is False
        ]
    lines.append(f"\nNot converged: {len(failed)} of ours" + "".join(f"; {' '.join(one)}" for one in failed[:20]) + ".")
    with writing(options.output / "published_fits.md") as path:
        path.write_text("\n".join(lines) + "\n")
    print("\n".join(lines))
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--library", type=Path, required=True, help="folder of MERL tables")
    parser.add_argument("--fits", type=Path, default=FITS, help="folder of .fit files")
    sweep_options(parser)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the cases and published_fits.md")
    return exit_status("published_fits", run, parser.parse_args(argv), RESUMABLE)


if __name__ == "__main__":
    sys.exit(main())
