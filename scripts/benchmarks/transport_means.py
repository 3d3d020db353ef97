#!/usr/bin/env python3
"""Claim: the means of Mitsuba's shared paths and of the transport agree within 0.2 %.

    python scripts/benchmarks/transport_means.py [--library DIR] [--samples N]

Sphere and bunny under the probes of scripts/benchmarks/transport.py: sums over pixels and channels of Mitsuba's
images, two seeds, over those of the transport with 16384 samples. Each entry: the ratio minus 1, and the standard
error that the two seeds tell. Only the columns of the six materials are gathered.
"""

import warnings
from math import sqrt
from pathlib import Path

import torch
from tqdm import tqdm

from torchbrdf import LightProbe, MaterialLibrary, MeshView, SphereView, View, render_basis
from torchbrdf.command_line import Parser
from torchbrdf.experiments import SHARED
from transport import MATERIALS, open_probe, own_colours


def main() -> None:
    """Print the table."""
    parser = Parser.of_script(__doc__)
    parser.add_argument("--library", type=Path, help="directory of MERL files; default: the embedded library")
    parser.add_argument("--probes", nargs="+", default=["default", "uffizi.hdr", "grace.hdr"], help="default or a file")
    parser.add_argument("--shapes", nargs="+", choices=["sphere", "bunny"], default=["sphere", "bunny"])
    parser.add_argument("--samples", type=int, default=32768, help="of Mitsuba, a pixel and seed")
    options = parser.parse_args()
    whole = MaterialLibrary.from_files(options.library or "default")
    library = MaterialLibrary.from_tables([whole.table(name) for name in MATERIALS])
    warnings.simplefilter("ignore")
    views: dict[str, View] = {"sphere": SphereView(64), "bunny": MeshView(SHARED / "shapes" / "bunny.ply", 64)}
    rows, everything = [], []
    for shape in options.shapes:
        view = views[shape]
        for name in tqdm(options.probes, desc=shape, leave=False):
            ratios, errors = compare(library, open_probe(name), view, options.samples)
            everything.append((ratios, errors))
            cells = " | ".join(f"{r:+.2%} ± {e:.2%}" for r, e in zip(ratios.tolist(), errors.tolist(), strict=True))
            rows.append(f"| {shape}, {Path(name).stem} | {cells} |")
    print("| scene | " + " | ".join(MATERIALS) + " |")
    print("|---|" + "---:|" * len(MATERIALS))
    print("\n".join(rows))
    all_ratios, all_errors = (torch.cat(parts) for parts in zip(*everything, strict=True))
    weights = all_errors.clamp_min(1e-5) ** -2
    mean = float((weights * all_ratios).sum() / weights.sum())
    print(f"mean of all {len(all_ratios)}: {all_ratios.mean():+.3%}; each weighted by its precision: {mean:+.3%}")
    print(f"root mean square of ratio / error: {sqrt(float(((all_ratios / all_errors) ** 2).mean())):.2f}")


def compare(
    library: MaterialLibrary, probe: LightProbe, view: View, samples: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """(M,) ratios minus 1, and their standard errors."""
    ours = own_colours(render_basis(library, probe, view, samples=16384, seed=1)).sum((1, 2, 3))
    found = [own_colours(render_basis(library, probe, view, "mitsuba", samples, seed)) for seed in (2, 3)]
    first, second = (images.sum((1, 2, 3)) / ours - 1 for images in found)
    return (first + second) / 2, (first - second).abs() / 2


if __name__ == "__main__":
    main()
