#!/usr/bin/env python3
"""Claim: a measured material of the RGL database looks the same as a table, and a table as a `.bsdf` file.

    python scripts/benchmarks/rgl_format.py ../shared/data/rgl ../shared/data/rgl_more

Spheres of 32 x 32 pixels under four probes: Mitsuba's `measured` of the original beside `tb.render` of its table, and
`measured` of the file written of the table beside our plugin `merl`. Relative RMS in percent; the Monte Carlo noise of
the references is told by two halves of their samples and taken off in squares. Negative radiance of the original, of
colours outside Rec. 709, counts as 0, as in a photograph.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import torch
from torch import Tensor

import torchbrdf as tb
from speed.rows import publish
from torchbrdf.brdf import METRIC_NAMES, RGL_SUFFIX, cell_difference
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.images import relative_rms
from torchbrdf.mitsuba_backend import HalfRenderings, MitsubaScene

PROBES = ("grace.hdr", "uffizi.hdr", "ennis.hdr", "apartment.exr")
SIZE = 32


def rest(image: Tensor, reference: HalfRenderings, mask: Tensor, noise: float) -> float:
    """Percent of the difference that is no noise."""
    difference = relative_rms(image.clamp_min(0), reference.image.clamp_min(0), mask)
    return 100 * max(0.0, difference**2 - noise**2) ** 0.5


def line(path: Path, probes: Sequence[tb.LightProbe], samples: int, folder: Path) -> str:
    """One row of the table."""
    view, written = tb.SphereView(SIZE), folder / f"written{RGL_SUFFIX}"
    start = time.perf_counter()
    table = tb.read_table(path)
    read = time.perf_counter() - start
    start = time.perf_counter()
    table.save(written)
    wrote = time.perf_counter() - start
    back = tb.read_table(written)
    cells = [f"{path.stem.removesuffix('_rgb')} | {100 * table.measured_share:.1f}"]
    for probe in probes:
        original, again = (
            MitsubaScene(view, probe, {"type": "measured", "filename": str(file)}).render_halves(samples, seed)
            for seed, file in enumerate((path, written))
        )
        plugin = MitsubaScene(view, probe, table).render_halves(samples, 2)
        one = rest(tb.render(table, probe, view), original, view.mask, original.noise)
        other = rest(again.image, plugin, view.mask, (again.noise**2 + plugin.noise**2) ** 0.5)
        cells.append(f"{one:.1f}, {other:.1f} ({100 * original.noise:.1f}, {100 * plugin.noise:.1f})")
    cells.append(", ".join(f"{100 * cell_difference(back, table, name):.1f}" for name in METRIC_NAMES))
    return "| " + " | ".join([*cells, f"{read:.1f}, {wrote:.1f}"]) + " |"


def lines(options: argparse.Namespace) -> Iterator[str]:
    """The table, row by row."""
    probes = [tb.LightProbe.open(options.probes / name) for name in PROBES]
    errors = f"there and back: {', '.join(METRIC_NAMES)}, %"
    heads = ["material", "measured cells, %", *PROBES, errors, "read, write, s"]
    yield f"| {' | '.join(heads)} |"
    yield "|---|" + "---:|" * (len(heads) - 1)
    with tempfile.TemporaryDirectory() as folder:
        for path in sorted(path for one in options.folders for path in one.glob(f"*{RGL_SUFFIX}")):
            yield line(path, probes, options.samples, Path(folder))


def run(options: argparse.Namespace) -> int:
    torch.manual_seed(0)
    publish("\n".join(lines(options)), options.document)
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("folders", type=Path, nargs="+", help=f"of {RGL_SUFFIX} files")
    parser.add_argument("--probes", type=Path, default=Path("../shared/data/probes"), help="default: %(default)s")
    parser.add_argument("--samples", type=int, default=1 << 15, help="a pixel; default: %(default)s")
    parser.add_argument("--document", type=Path, help="page between whose markers the table goes")
    return exit_status("rgl_format", run, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
