#!/usr/bin/env python3
"""Claim: at equal error the transport is at least 500 times faster than Mitsuba, which renders one BRDF at a time.

    GOMP_SPINCOUNT=5000 python scripts/benchmarks/transport.py [--library DIR] [--shapes sphere] [--figure FILE.png]

Ways to the basis images (300 x RGB) of a sphere and of the Stanford bunny under three probes:
(a) `one by one`: Mitsuba's `direct` integrator with the plugin `merl`, one basis BRDF at a time, 300 renderings;
(b) `shared paths`: Mitsuba's light and shadows, all basis BRDFs gathered from the same paths (backend="mitsuba");
(c) `transport`: this package's own (backend="sampled");
(d) `harmonic`: precomputed for the library (backend="harmonic"), on the sphere. One row: it has no number of samples.
Error of a material: |image - reference| / |reference| over the pixels of the mask, each channel of the material in
its own colour of the light. The reference is a float32 rendering by (c) with 16 times the samples, a mean of two seeds
that nothing else uses; how far the two are apart tells its own error. Since (c) could share a mistake with it, a
second table of every scene holds the means of (a), (b) and (c) over its own: a mistake of either would show there.
Seconds: the whole basis, by the clock, after a warm-up; for (a) 300 times the mean over the materials.
"""

import statistics
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from math import log
from pathlib import Path

import torch
from torch import Tensor
from tqdm import tqdm

from torchbrdf import BasisImages, LightProbe, MaterialLibrary, MerlTable, MeshView, SphereView, View, render_basis
from torchbrdf.command_line import Parser
from torchbrdf.experiments import SHARED
from torchbrdf.images import relative_rms
from torchbrdf.mitsuba_backend import MitsubaScene
from torchbrdf.rendering import render_tables
from torchbrdf.transport import DEFAULT_SAMPLES
from torchbrdf.transport.harmonic import unsuited

MATERIALS = ("pink-felt", "light-red-paint", "red-metallic-paint", "black-phenolic", "brass", "chrome")
"""From diffuse to mirror-like."""

TARGET = 0.005
HARMONIC_REPEATS = 7
"""Of which the median counts."""

METHODS = {"a": "Mitsuba, one by one", "b": "Mitsuba, shared paths", "c": "transport", "d": "harmonic"}
SAMPLES = {"a": (64, 256, 1024, 4096), "b": (64, 256, 1024, 4096), "c": (64, 256, 1024, 4096, 16384), "d": (0,)}


@dataclass(frozen=True)
class Run:
    """One method with one number of samples a pixel.

    seconds  for the whole basis
    errors   (M,) relative, one for each material
    images   (M, 3, H, W)
    """

    method: str
    samples: int
    seconds: float
    errors: Tensor
    images: Tensor


@dataclass(frozen=True)
class Reference:
    """images (M, 3, H, W), and the relative error (M,) that two seeds tell."""

    images: Tensor
    errors: Tensor


def main() -> None:
    """Print the tables, draw the figure."""
    parser = Parser.of_script(__doc__)
    parser.add_argument("--library", type=Path, help="directory of MERL files; default: the embedded library")
    parser.add_argument("--probes", nargs="+", default=["default", "uffizi.hdr", "grace.hdr"], help="default or a file")
    parser.add_argument("--shapes", nargs="+", default=["sphere", "bunny"], choices=["sphere", "bunny"])
    parser.add_argument("--reference-samples", type=int, default=65536)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--figure", type=Path, help="log-log plot, .png")
    options = parser.parse_args()

    library = MaterialLibrary.from_files(options.library or "default")
    tables = [library.table(name) for name in MATERIALS]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the bunny's file has no normals
        views: dict[str, View] = {
            "sphere": SphereView(options.size),
            "bunny": MeshView(SHARED / "shapes" / "bunny.ply", options.size),
        }
        views = {shape: views[shape] for shape in options.shapes}
        probes = {Path(name).stem: open_probe(name) for name in options.probes}
    print(f"{library!r}, {torch.get_num_threads()} threads, reference {options.reference_samples} samples a pixel")
    scenes = {}
    for shape, view in views.items():
        for light, probe in probes.items():
            runs, reference = measure_scene(library, tables, probe, view, options.reference_samples)
            scenes[f"{shape}, {light}"] = runs
            print_scene(f"{shape}, {light}", runs, reference, view)
    print_ratios(scenes)
    if options.figure:
        draw(scenes, options.figure)


def open_probe(name: str) -> LightProbe:
    return LightProbe.default() if name == "default" else LightProbe.open(SHARED / "probes" / name, rows="poles")


def measure_scene(
    library: MaterialLibrary, tables: list[MerlTable], probe: LightProbe, view: View, reference_samples: int
) -> tuple[list[Run], Reference]:
    """All runs of one view under one probe."""
    twins = [render_tables(tables, probe, view, reference_samples, 9000 + k) for k in range(2)]
    images = (twins[0] + twins[1]) / 2
    reference = Reference(images, errors_of(twins[0], images, view))
    scene = MitsubaScene(view, probe, tables[0])

    def one_by_one(samples: int, seed: int) -> tuple[Tensor, float]:
        found = []
        start = time.perf_counter()
        for index, table in enumerate(tables):
            scene.set_table(table)
            found.append(scene.render(samples, 100 * seed + index))
        return torch.stack(found), (time.perf_counter() - start) / len(tables) * library.n

    def whole(backend: str) -> Callable[[int, int], tuple[Tensor, float]]:
        def render(samples: int, seed: int) -> tuple[Tensor, float]:
            start = time.perf_counter()
            basis = render_basis(library, LightProbe(probe.radiance), view, backend, samples, seed)
            return own_colours(basis), time.perf_counter() - start

        return render

    def harmonic(_: int, __: int) -> tuple[Tensor, float]:
        seconds = []
        for _ in range(HARMONIC_REPEATS):
            start = time.perf_counter()
            basis = render_basis(library, LightProbe(probe.radiance), view, "harmonic")
            seconds.append(time.perf_counter() - start)
        return own_colours(basis), statistics.median(seconds)

    ways = {"a": one_by_one, "b": whole("mitsuba"), "c": whole("sampled")}
    if unsuited(view) is None:
        ways["d"] = harmonic
    runs = []
    for method, render in tqdm(ways.items(), desc=f"{view!r}", leave=False):
        render(SAMPLES[method][0], 0)  # the warm-up compiles
        for seed, samples in enumerate(SAMPLES[method], 1):
            found, seconds = render(samples, seed)
            runs.append(Run(method, samples, seconds, errors_of(found, reference.images, view), found))
    return runs, reference


def own_colours(basis: BasisImages) -> Tensor:
    """(M, 3, H, W)."""
    return torch.stack([basis.image(name) for name in MATERIALS])


def errors_of(images: Tensor, reference: Tensor, view: View) -> Tensor:
    """(M,)."""
    return torch.tensor([relative_rms(i, r, view.mask) for i, r in zip(images, reference, strict=True)])


def seconds_for(runs: list[Run], method: str, material: int, error: float) -> float:
    """Time that a method takes to reach an error.

    Between two runs on a line through their logarithms; beyond the last by the law of Monte Carlo, time ~ 1 / error^2.
    """
    points = [(run.seconds, float(run.errors[material])) for run in runs if run.method == method]
    for (t0, e0), (t1, e1) in pairwise(points):
        if e1 <= error <= e0:
            return t0 * (t1 / t0) ** (log(error / e0) / log(e1 / e0))
    seconds, least = points[-1]
    return seconds * (least / error) ** 2 if least > error else points[0][0]


def print_scene(name: str, runs: list[Run], reference: Reference, view: View) -> None:
    print(f"\n### {name}: {len(view.pixels)} pixels\n")
    print("| method | samples a pixel | seconds for 300 x RGB | " + " | ".join(MATERIALS) + " |")
    print("|---|---:|---:|" + "---:|" * len(MATERIALS))
    for run in runs:
        errors = " | ".join(f"{error:.2%}" for error in run.errors.tolist())
        print(f"| ({run.method}) {METHODS[run.method]} | {run.samples} | {run.seconds:.2f} | {errors} |")
    print("| the reference's own error | | | " + " | ".join(f"{e:.3%}" for e in reference.errors.tolist()) + " |")
    print("\nMean of the image over that of the reference, minus 1, with the most samples:\n")
    print("| method | " + " | ".join(MATERIALS) + " |")
    print("|---|" + "---:|" * len(MATERIALS))
    for method in dict.fromkeys(run.method for run in runs):
        last = [run for run in runs if run.method == method][-1]
        ratios = last.images.sum((1, 2, 3)) / reference.images.sum((1, 2, 3)) - 1
        print(f"| ({method}) | " + " | ".join(f"{ratio:+.3%}" for ratio in ratios.tolist()) + " |", flush=True)


def print_ratios(scenes: dict[str, list[Run]]) -> None:
    """How many times longer (a) and (b) take than (c): at the error of (c) at its default, and at TARGET."""
    for target in (None, TARGET):
        where = f"the error of (c) with {DEFAULT_SAMPLES} samples" if target is None else f"{target:.1%} error"
        print(f"\n### Seconds of (a) and of (b) over those of (c), at {where}\n")
        print("| scene | method | " + " | ".join(MATERIALS) + " |")
        print("|---|---|" + "---:|" * len(MATERIALS))
        found: dict[str, list[float]] = {"a": [], "b": []}
        for name, runs in scenes.items():
            ours = next(run for run in runs if is_default(run))
            goals = ours.errors.tolist() if target is None else [target] * len(MATERIALS)
            for method, ratios in found.items():
                row = [seconds_for(runs, method, k, e) / seconds_for(runs, "c", k, e) for k, e in enumerate(goals)]
                ratios += row
                print(f"| {name} | ({method}) | " + " | ".join(f"{ratio:,.0f}" for ratio in row) + " |")
        for method, ratios in found.items():
            median = statistics.median(ratios)
            print(f"({method}): least {min(ratios):,.1f}, median {median:,.0f}, most {max(ratios):,.0f}")
    print("\n### Seconds of (a), (b) and (c) over those of (d), at the error of (d)\n")
    print("| scene | method | " + " | ".join(MATERIALS) + " |\n|---|---|" + "---:|" * len(MATERIALS))
    for name, runs in scenes.items():
        for ours in (run for run in runs if run.method == "d"):
            for method in ("a", "b", "c"):
                row = [seconds_for(runs, method, k, e) / ours.seconds for k, e in enumerate(ours.errors.tolist())]
                print(f"| {name} | ({method}) | " + " | ".join(f"{ratio:,.0f}" for ratio in row) + " |")
    worst = max(float(run.errors.max()) for runs in scenes.values() for run in runs if is_default(run))
    print(f"largest error of (c) with {DEFAULT_SAMPLES} samples: {worst:.2%}; asked for {TARGET:.1%}")


def is_default(run: Run) -> bool:
    """Whether it is what users get."""
    return (run.method, run.samples) == ("c", DEFAULT_SAMPLES)


def draw(scenes: dict[str, list[Run]], path: Path) -> None:
    """Error over time: median of the materials, and from the least to the largest."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    from torchbrdf.files import writing

    colours = {"a": "#b3541e", "b": "#2f6f9f", "c": "#2b7a3d", "d": "#7a2b76"}
    n_rows = len({name.split(",")[0] for name in scenes})
    size = (11, 0.6 + 3 * n_rows + 0.6 * (n_rows == 1))
    figure, axes = pyplot.subplots(n_rows, len(scenes) // n_rows, figsize=size, sharex=True, sharey=True, squeeze=False)
    for axis, (name, runs) in zip(axes.ravel(), scenes.items(), strict=True):
        for method, label in METHODS.items():
            mine = [run for run in runs if run.method == method]
            if not mine:
                continue
            seconds = [run.seconds for run in mine]
            errors = torch.stack([run.errors for run in mine])
            if len(mine) == 1:
                axis.vlines(seconds, errors.amin(1), errors.amax(1), color=colours[method], alpha=0.3, linewidth=4)
            axis.fill_between(seconds, errors.amin(1), errors.amax(1), color=colours[method], alpha=0.15, linewidth=0)
            axis.plot(seconds, errors.median(1).values, "o-", color=colours[method], label=f"({method}) {label}", ms=4)
        axis.axhline(TARGET, color="0.5", linewidth=0.8, linestyle=":")
        axis.set(xscale="log", yscale="log", title=name)
        axis.grid(alpha=0.25, which="major")
    for axis in axes[-1]:
        axis.set_xlabel("seconds for 300 basis images x RGB")
    for axis in axes[:, 0]:
        axis.set_ylabel("relative error of an image")
    axes[0, 0].legend(fontsize=8)
    figure.tight_layout()
    with writing(path) as temporary:
        figure.savefig(temporary, dpi=110)


if __name__ == "__main__":
    main()
