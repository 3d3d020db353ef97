#!/usr/bin/env python3
"""Claim: a new probe costs 0.1 s with the precomputed transport, at errors of 0.5 %, on 2 cores.

    python scripts/benchmarks/harmonic.py [--library DIR] [--repeats 9] [--tables perspective]

Compares all basis images of a sphere of 64 x 64 pixels, 300 x RGB, with converged runs of the sampled transport (two
seeds of `--reference-samples` each, which nothing else uses; how far they are apart tells the reference's own error).
Prints, each as a Markdown table:
- errors |image - reference| / |reference| of all basis images under every probe, and seconds from a new probe to them,
  beside the sampled transport with its default number of samples and with fewer;
- seconds from a new probe to the reconstruction of one photograph, factors included;
- what each way of skipping work gains: pixels, classes, frequencies; low rank; a part of zero;
- a normal map seen by an orthographic camera;
- errors and seconds for balls in perspective, beside those of the orthographic view.
Seconds are medians by the clock, after a warm-up; the sampled transport's, of three.
"""

import argparse
import math
import statistics
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf import BRDFEstimator, LightProbe, MaterialClasses, MaterialLibrary, MeshView, NormalMapView, SphereView
from torchbrdf.command_line import Parser
from torchbrdf.experiments import SHARED, relative
from torchbrdf.rendering import render_basis
from torchbrdf.transport import DEFAULT_SAMPLES
from torchbrdf.transport.harmonic import HarmonicBasis, transport_of, zones
from torchbrdf.view import View
from transport import open_probe

PROBES = ("default", "grace.hdr", "ennis.hdr", "uffizi.hdr", "forest.exr")
SAMPLES = (256, 1024, DEFAULT_SAMPLES)
DISTANCES = (math.inf, 30.0, 15.0, 12.0, 8.0, 6.0)
"""Of a camera from the middle of a ball, in radii."""

TABLES = ("errors", "reconstruction", "levers", "normal-maps", "perspective")


def main() -> None:
    """Print all tables."""
    parser = Parser.of_script(__doc__)
    parser.add_argument("--library", type=Path, help="directory of MERL files; default: the embedded library")
    parser.add_argument("--probes", nargs="+", default=PROBES, help="default or a file of the shared probes")
    parser.add_argument("--reference-samples", type=int, default=32768)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--tables", nargs="+", choices=TABLES, default=TABLES)
    parser.add_argument("--every", type=int, default=1, help="of so many materials only the first")
    options = parser.parse_args()
    warnings.simplefilter("ignore")  # negative texels, meshes without normals

    library = MaterialLibrary.from_files(options.library or "default")
    library = library.subset(library.names[:: options.every])
    start = time.perf_counter()
    transport = transport_of(library, progress=True, perspective="perspective" in options.tables)
    opened = time.perf_counter() - start
    sizes = [
        4e-6 * sum(band.even.numel() + band.odd.numel() for group in groups for band in group.bands)
        for groups in (transport.groups, transport.added)
    ]
    print(f"{library!r}, {torch.get_num_threads()} threads; transport opened or built in {opened:.1f} s, "
          f"{sizes[0]:.0f} MB and {sizes[1]:.0f} MB for perspective")  # fmt: skip
    probes = {Path(name).stem: open_probe(name) for name in options.probes}
    view = SphereView(64)
    start = time.perf_counter()
    transport.lookup(view)
    print(f"lookup of a view, once: {time.perf_counter() - start:.2f} s\n")
    if "errors" in options.tables:
        print_errors(library, probes, view, options)
    if "reconstruction" in options.tables:
        print_reconstruction(library, probes, view, options.repeats)
    if "levers" in options.tables:
        print_levers(library, probes["ennis" if "ennis" in probes else next(iter(probes))], view, options.repeats)
    if "normal-maps" in options.tables:
        print_normal_maps(library, probes, options.reference_samples)
    if "perspective" in options.tables:
        print_perspective(library, probes, options)


def print_errors(
    library: MaterialLibrary, probes: dict[str, LightProbe], view: View, options: argparse.Namespace
) -> None:
    """All basis images against the converged sampled transport."""
    print("| probe | transport | seconds | median | 95 % within | worst |\n|---|---|---:|---:|---:|---:|")
    for name, probe in probes.items():
        reference, own = reference_of(library, probe, view, options.reference_samples)

        def row(what: str, seconds: float, found: Tensor, reference: Tensor = reference, name: str = name) -> None:
            print(f"| {name} | {what} | {seconds:.3f} | {summary(relative(found, reference))} |", flush=True)

        def harmonic(probe: LightProbe = probe) -> Tensor:
            return render_basis(library, LightProbe(probe.radiance), view, "harmonic").packed

        row("harmonic", median_seconds(harmonic, options.repeats), harmonic())
        for samples in SAMPLES:

            def sampled(probe: LightProbe = probe, samples: int = samples) -> Tensor:
                return render_basis(library, LightProbe(probe.radiance), view, "sampled", samples).packed

            row(f"sampled, {samples}", median_seconds(sampled, 3), sampled())
        print(f"| {name} | the reference's own error | | {summary(own)} |")


def reference_of(library: MaterialLibrary, probe: LightProbe, view: View, samples: int) -> tuple[Tensor, Tensor]:
    """Images (n, 3, P), and their relative errors (n,) as two seeds tell them."""
    twins = [render_basis(library, probe, view, "sampled", samples, 9000 + k).packed for k in range(2)]
    reference = (twins[0] + twins[1]) / 2
    return reference, relative(twins[0], reference)


def summary(errors: Tensor) -> str:
    median, most, worst = errors.quantile(torch.tensor([0.5, 0.95, 1.0])).tolist()
    return f"{median:.2%} | {most:.2%} | {worst:.2%}"


def median_seconds(work: Callable[[], object], repeats: int) -> float:
    work()
    found = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        found.append(time.perf_counter() - start)
    return statistics.median(found)


def print_reconstruction(library: MaterialLibrary, probes: dict[str, LightProbe], view: View, repeats: int) -> None:
    """From a new probe to the weights of one photograph."""
    classes = MaterialClasses.fit(library)
    print("\n| new probe to reconstruction | seconds |\n|---|---:|")
    for name, probe in probes.items():
        photograph = render_basis(library, probe, view, "harmonic").image(library.names[0])

        def reconstruct(probe: LightProbe = probe, photograph: Tensor = photograph) -> object:
            basis = render_basis(library, LightProbe(probe.radiance), view, "harmonic")
            return BRDFEstimator(basis, classes)(photograph).weights

        print(f"| {name} | {median_seconds(reconstruct, repeats):.3f} |", flush=True)


def print_levers(library: MaterialLibrary, probe: LightProbe, view: SphereView, repeats: int) -> None:
    """What skipping gains, and what compression saves."""

    def seconds(library: MaterialLibrary, probe: LightProbe, view: View) -> float:
        return median_seconds(lambda: render_basis(library, probe, view, "harmonic"), repeats)

    smooth = LightProbe(1 + 0.5 * torch.sin(torch.linspace(0, torch.pi, 128))[:, None].expand(3, 128, 256))
    middle = view.mask & (view.normals[2:] > 0.7071)
    inner = NormalMapView(view.normals, middle)
    few = library.subset(library.names[: len(library) // 4])
    print("\n| skipped | seconds |\n|---|---:|")
    print(f"| nothing | {seconds(library, probe, view):.3f} |")
    print(f"| rings outside the mask: normals within 45 degrees of the view | {seconds(library, probe, inner):.3f} |")
    print(f"| classes: a quarter of the columns | {seconds(few, probe, view):.3f} |")
    print(f"| frequencies: a probe without detail | {seconds(library, smooth, view):.3f} |")
    n = library.stored.columns.shape[1]
    groups = transport_of(library).groups
    dense = sum(2 * zone.rings * zone.elevations * zone.frequencies * n for zone in zones())
    finest = zones()[0]
    one_grid = 2 * finest.rings * finest.elevations * finest.frequencies * n
    local = sum(2 * g.n_rings * g.bands[0].even.shape[1] * sum(len(b.even) for b in g.bands) * n for g in groups)
    joint = sum(2 * g.n_rings * b.even.shape[1] * len(b.even) * g.mixing.shape[1] for g in groups for b in g.bands)
    kept = sum(b.even.numel() + b.odd.numel() for g in groups for b in g.bands)
    odd = sum(b.odd.numel() for g in groups for b in g.bands)
    print("\n| kernels | MB |\n|---|---:|")
    for what, size in (
        ("one grid, every column", one_grid),
        ("zones of the half angle, each with its own grid", dense),
        ("and only elevations that a ring reflects, frequencies that it needs", local),
        ("and mixtures of materials, one basis a group", joint),
        ("and a basis of its own for each band, even and odd part", kept),
        ("of which odd parts", odd),
    ):
        print(f"| {what} | {4e-6 * size:,.0f} |")


def print_normal_maps(library: MaterialLibrary, probes: dict[str, LightProbe], samples: int) -> None:
    """Shapes given by their normals."""
    print("\n| normal map, probe | median | 95 % within | worst |\n|---|---:|---:|---:|")
    for shape in ("bunny", "dragon"):
        mesh = MeshView(SHARED / "shapes" / f"{shape}.ply", 64, shadows=False)
        view = NormalMapView(mesh.normals, mesh.mask)
        for name in ("uffizi", "ennis"):
            if name in probes:
                reference, own = reference_of(library, probes[name], view, samples)
                found = render_basis(library, probes[name], view, "harmonic").packed
                print(f"| {shape}, {name} | {summary(relative(found, reference))} |")
                print(f"| the reference's own error | {summary(own)} |", flush=True)


def print_perspective(library: MaterialLibrary, probes: dict[str, LightProbe], options: argparse.Namespace) -> None:
    """Balls from nearer and nearer; what it would cost to take them for orthographic."""
    print("\n| probe | radii away | seconds | median | 95 % within | worst | as if orthographic, median |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    for name, probe in probes.items():
        orthographic = HarmonicBasis(library, probe, SphereView(64)).basis_at().packed
        for distance in DISTANCES:
            fov_deg = None if math.isinf(distance) else 2 * math.degrees(math.asin(1 / distance))
            view = SphereView(64, fov_deg=fov_deg)
            reference, _ = reference_of(library, probe, view, options.reference_samples)

            def harmonic(probe: LightProbe = probe, view: View = view) -> Tensor:
                return render_basis(library, LightProbe(probe.radiance), view, "harmonic").packed

            seconds, errors = median_seconds(harmonic, options.repeats), relative(harmonic(), reference)
            ignored = relative(orthographic, reference).median()
            print(f"| {name} | {distance:g} | {seconds:.3f} | {summary(errors)} | {ignored:.1%} |", flush=True)


if __name__ == "__main__":
    main()
