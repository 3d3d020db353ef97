#!/usr/bin/env python3
"""How well `tb.align` finds the rotation of a probe, on measured materials: the tables of docs/results/alignment.md.

    python scripts/make_targets.py --measured ../shared/data/rgl -o targets
    python scripts/make_targets.py --measured ../shared/data/rgl -o turned --turned 5 --seed 1 --probes P1 P2 ...
    python scripts/benchmarks/alignment.py --turned turned --targets targets --library merl -o OUT

Mitsuba renders each material under a probe turned by up to 5 degrees about a random axis, and under the probe as it is;
both photographs get noise, and are aligned and reconstructed with the probe as it is. The error is that of the
re-rendering under all other probes of the targets, beside that with the true rotation and that without alignment.
Materials are sorted by how much their photographs lose when each pixel becomes the mean of 3 x 3: the glossier half
loses more.

OUT holds one file a finished case: run the same command again to continue.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

import torchbrdf as tb
from alignment_cases import align_case
from torchbrdf.command_line import RESUMABLE, Parser, exit_status
from torchbrdf.experiments import SHARED, SweepInputs, Target, read_targets, sweep_options
from torchbrdf.files import writing
from torchbrdf.sweep import Task, sweep

Rows = Sequence[Mapping[str, Any]]


def sharpness(target: Target) -> float:
    """Relative RMS of a photograph less its means over 3 x 3 pixels, away from the silhouette."""
    image, mask = target.photograph[None], tb.SphereView(target.size).mask[None].float()
    inside = torch.nn.functional.avg_pool2d(mask, 3, 1, 1) == 1
    means = torch.nn.functional.avg_pool2d(image, 3, 1, 1)
    return float(((image - means) * inside).norm() / (image * inside).norm())


def by_gloss(targets: Sequence[Target]) -> list[str]:
    """The materials from matte to glossy, by the mean of `sharpness` over the probes."""
    materials = sorted({target.material for target in targets})
    mean = {name: [sharpness(target) for target in targets if target.material == name] for name in materials}
    return sorted(materials, key=lambda name: sum(mean[name]) / len(mean[name]))


def quantile(values: Sequence[float], q: float) -> float:
    return float(torch.tensor(values, dtype=torch.float64).quantile(q))


def mean(rows: Rows, key: str) -> float:
    return sum(row[key] for row in rows) / len(rows)


def line(name: str, rows: Rows) -> str:
    """One line of the table."""
    left = [row["left"] for row in rows]
    worse = [100 * (row["right_error_aligned"] / row["right_error"] - 1) for row in rows]
    errors = [100 * mean(rows, f"error_{kind}") for kind in ("given", "aligned", "true")]
    return (
        f"| {name} | {len(rows)} | {quantile(left, 0.5):.2f} | {quantile(left, 0.9):.2f} | {max(left):.2f} | "
        f"{quantile([row['uncertainty'] for row in rows], 0.5):.2f} | {errors[0]:.2f} | {errors[1]:.2f} | "
        f"{errors[2]:.2f} | {100 * (errors[1] / errors[2] - 1):+.1f} % | {max(worse):+.1f} % |"
    )


def report(rows: Rows, gloss: Sequence[str]) -> str:
    """The table in Markdown: all cases, both halves, each probe and each material."""
    half = len(gloss) // 2
    groups: dict[str, Rows] = {
        "all": rows,
        "glossier half": [row for row in rows if row["material"] in gloss[half:]],
        "matter half": [row for row in rows if row["material"] in gloss[:half]],
    }
    for key, names in (("probe", sorted({row["probe"] for row in rows})), ("material", gloss)):
        groups |= {name: [row for row in rows if row[key] == name] for name in names}
    head = (
        "| | cases | left, degrees: median | 90 % | largest | standard deviation, median | novel error as given, % | "
        "aligned | true rotation | aligned over true | probe was right: worst change |"
    )
    lines = [head, "|---" + "|---:" * 10 + "|", *(line(name, some) for name, some in groups.items() if some)]
    seconds = [row["seconds"] for row in rows]
    lines.append(
        f"\nEvaluations: median {quantile([row['evaluations'] for row in rows], 0.5):.0f}, most "
        f"{max(row['evaluations'] for row in rows)}. Seconds on one thread: median {quantile(seconds, 0.5):.1f}, most "
        f"{max(seconds):.1f}. Probes that were right and were turned: "
        f"{sum(row['right_turned'] > 0 for row in rows)} of {len(rows)}."
    )
    return "\n".join(lines)


def run(options: argparse.Namespace) -> int:
    turned, targets = read_targets(options.turned), read_targets(options.targets)
    if any("rotation" not in target.metadata for target in turned):
        raise ValueError(f"{options.turned}: targets of probes that were not turned; make them with --turned 5")
    names = {target.probe for target in [*targets, *turned]}
    inputs = SweepInputs.open(options.library, options.probes, names)
    places = {
        **inputs.places,
        "turned": str(options.turned.resolve()),
        "unturned": str(options.targets.resolve()),
    }
    common = {"library": inputs.library.source, "probes": inputs.probes, "noise": options.noise, "seed": options.seed}
    tasks = [
        Task(
            f"{target.probe}-{target.material}",
            common | {"size": target.size, "observed": target.probe, "material": target.material},
            places,
        )
        for target in turned
    ]
    found = sweep(align_case, tasks, options.output / "cases", options.processes, options.scheduler, "alignments")
    rows = [
        {"probe": target.probe, "material": target.material, **found[task.name]}
        for target, task in zip(turned, tasks, strict=True)
    ]
    table = report(rows, by_gloss(targets))
    with writing(options.output / "alignment.md") as path:
        path.write_text(table + "\n")
    print(table)
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--turned", type=Path, required=True, help="folder of targets made with --turned")
    parser.add_argument("--targets", type=Path, required=True, help="folder of the same targets, not turned")
    parser.add_argument("--probes", type=Path, default=SHARED / "probes", help="folder of the probes")
    parser.add_argument("--library", type=Path, help="folder of MERL tables; default: the embedded library")
    parser.add_argument("--noise", type=float, default=1.0, help="of a pixel, in per cent; default: 1")
    parser.add_argument("--seed", type=int, default=0, help="of the noise")
    sweep_options(parser)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the cases and alignment.md")
    return exit_status("alignment", run, parser.parse_args(argv), RESUMABLE)


if __name__ == "__main__":
    sys.exit(main())
