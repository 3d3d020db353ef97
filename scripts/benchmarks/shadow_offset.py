#!/usr/bin/env python3
"""Claim: where Mitsuba and the transport differ on a mesh with deep folds, Mitsuba's ray offset is most of the reason.

    python scripts/benchmarks/shadow_offset.py --library merl

Mitsuba starts its shadow rays 9e-5 (1 + |p|) above a surface at p, in the units of the scene: on a mesh of a tenth of a
unit that is a thousandth of its size, and light leaks into the folds. Renders the Buddha in its own units, ten and a
hundred times as large, by both. For the transport only rounding may change with the units; for Mitsuba the ratio of the
means falls as its offset shrinks against the mesh. With --fine the transport also takes more points a pixel.
"""

import tempfile
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

import torchbrdf as tb
from torchbrdf.command_line import Parser
from torchbrdf.experiments import SHARED
from torchbrdf.mitsuba_backend import MitsubaScene
from torchbrdf.view import TriangleMesh, mesh_view

MATERIAL = "pink-fabric"
OFFSET = 9e-5
"""Mitsuba's, in units of the scene at the origin."""


def main() -> None:
    """Print the table."""
    parser = Parser.of_script(__doc__)
    parser.add_argument("--library", type=Path, help="directory of MERL files; default: the embedded library")
    parser.add_argument("--samples", type=int, default=65536, help="of Mitsuba, a pixel")
    parser.add_argument("--fine", type=int, nargs="+", default=[16], help="points along a side of a pixel")
    options = parser.parse_args()
    library = tb.MaterialLibrary.from_files(options.library or "default")
    table = library.table(MATERIAL)
    probe = tb.LightProbe.open(SHARED / "probes" / "venice.exr", rows="poles")
    warnings.simplefilter("ignore")
    mesh_view._MOST_POINTS = 1 << 26
    mesh = TriangleMesh.open(SHARED / "shapes" / "buddha.ply")
    print("| points a pixel | radius of the mesh | Mitsuba's offset / radius | Mitsuba / transport | noise |")
    print("|---:|---:|---:|---:|---:|")
    for fine in options.fine:
        mesh_view._FINEST = fine
        for scale in (1, 10, 100):
            larger = replace(mesh, vertices=((mesh.vertices - mesh.centre) * scale).astype(np.float32))
            with tempfile.TemporaryDirectory() as folder:
                larger.save(Path(folder) / "mesh.ply")
                view = tb.MeshView(Path(folder) / "mesh.ply", 64)
            ours = tb.render(table, probe, view, samples=16384, seed=1).sum()
            halves = MitsubaScene(view, probe, table).render_halves(options.samples)
            first, second = (float(half.sum() / ours) for half in (halves.first, halves.second))
            share = OFFSET * (1 + larger.radius / 2) / larger.radius
            ratio = f"{(first + second) / 2:.4f} | {abs(first - second) / 2:.4f}"
            print(f"| {fine} x {fine} | {larger.radius:.2f} | {share:.1e} | {ratio} |", flush=True)


if __name__ == "__main__":
    main()
