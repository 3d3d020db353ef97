"""One point of `growth.py`, in a process of its own: `python -m speed.growing AXIS SIZE INPUTS FOLDER OUTPUT`.

The steps of an axis write seconds and the largest resident memory while they ran, and what of it are pages of files.
"""

import json
import os
import shutil
import statistics
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

import torchbrdf as tb
from speed.called import T, changed, opened
from speed.processes import resident
from torchbrdf.brdf import column_sources, library_cache
from torchbrdf.transport.harmonic import transport_of

SIZE = 64
"""Pixels across, but where the axis is pixels."""

FEW_SAMPLES = 64
"""A pixel, of the sampled transport: its time is proportional to them."""

MOST_PRECOMPUTED = 100
"""Materials up to which the harmonic transport of a library is precomputed."""

MOST_TABLES = 10
"""Photographs of a batch up to which all tables are made."""

ALIGNED = 128
"""Pixels across up to which a photograph is aligned."""


@dataclass(frozen=True)
class Point:
    """One measurement: MiB and seconds of a step."""

    axis: str
    step: str
    size: int
    seconds: float
    peak: float
    mapped: float
    revision: str = ""


class Steps:
    """Measures the steps of one size of an axis."""

    def __init__(self, axis: str, size: int) -> None:
        """Begin with none."""
        self.axis, self.size, self.points = axis, size, list[Point]()

    def __call__(self, step: str, work: Callable[[int], T], repeats: int = 3) -> T:
        """Measure work(0), work(1), ...; the median, without the first where there are several. Gives the last."""
        forget_peak()
        seconds = []
        for k in range(repeats):
            start = time.perf_counter()
            made = work(k)
            seconds.append(time.perf_counter() - start)
        median = statistics.median(seconds[1:] or seconds)
        self.points.append(Point(self.axis, step, self.size, median, peak(), resident_files()))
        return made


def forget_peak() -> None:
    """Let the largest resident memory begin anew."""
    Path("/proc/self/clear_refs").write_text("5")


def peak() -> float:
    """MiB since `forget_peak`."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 2**10 for line in lines if line.startswith("VmHWM"))


def resident_files() -> float:
    """MiB of pages of files."""
    return resident(os.getpid())[1]


def pixels(size: int, inputs: Path, folder: Path, steps: Steps) -> None:
    """A ball of more and more pixels, the embedded library."""
    library, probe, view = tb.MaterialLibrary.default(progress=False), opened(inputs, "default"), tb.SphereView(size)
    steps.size = len(view.pixels)
    classes = tb.MaterialClasses.fit(library)
    steps("basis images, the view's first", lambda k: tb.render_basis(library, changed(probe, k), view), 1)
    basis = steps("basis images", lambda k: tb.render_basis(library, changed(probe, k), view))
    photograph = basis.image(library.names[20])
    estimating(steps, basis, classes, photograph)
    steps(
        f"basis images, {FEW_SAMPLES} samples a pixel",
        lambda k: tb.render_basis(library, changed(probe, k), view, samples=FEW_SAMPLES),
        1,
    )
    table = tb.MerlTable.open(inputs / "glossy.binary")
    steps("`tb.render` of a table", lambda k: tb.render(table, changed(probe, k), view), 2)
    if size <= ALIGNED:
        steps("`tb.align`", lambda k: tb.align(photograph, changed(probe, k), view, library).rotation, 1)


def columns(materials: int, inputs: Path, folder: Path, steps: Steps) -> None:
    """Larger and larger libraries, of materials like the embedded ones."""
    probe, view = opened(inputs, "default"), tb.SphereView(SIZE)
    steps.size = 3 * materials
    own = folder / f"library-{materials}"
    try:
        stored = steps("library expanded", lambda _: library_cache.open_or_build(strangers(materials), own, False), 1)
        library = tb.MaterialLibrary(stored, tuple(range(materials)))
        classes = steps("classes", lambda _: tb.MaterialClasses.fit(library), 1)
        if materials <= MOST_PRECOMPUTED:
            steps("transport precomputed", lambda _: transport_of(library), 1)
            tb.render_basis(library, probe, view)
            steps("basis images", lambda k: tb.render_basis(library, changed(probe, k), view))
        basis = steps(
            f"basis images, {FEW_SAMPLES} samples a pixel",
            lambda k: tb.render_basis(library, changed(probe, k), view, samples=FEW_SAMPLES),
            2,
        )
        photograph = basis.image(library.names[0])
        result = estimating(steps, basis, classes, photograph)
        steps("`result.brdf`", lambda _: result.brdf(library), 2)
    finally:
        shutil.rmtree(own, ignore_errors=True)


def photographs(count: int, inputs: Path, folder: Path, steps: Steps) -> None:
    """Batches under one probe."""
    library, probe, view = tb.MaterialLibrary.default(progress=False), opened(inputs, "default"), tb.SphereView(SIZE)
    estimator = tb.BRDFEstimator(tb.render_basis(library, probe, view), tb.MaterialClasses.fit(library))
    some = torch.load(inputs / "photographs.pt")
    batch = some.repeat(-(-count // len(some)), 1, 1, 1)[:count]
    estimator(batch[0])
    result = steps("estimates of a batch", lambda _: estimator(batch))
    if count <= MOST_TABLES:
        steps("tables of a batch", lambda _: [len(result[i].brdf(library).name) for i in range(count)], 1)


def estimating(
    steps: Steps, basis: tb.BasisImages, classes: tb.MaterialClasses, photograph: Tensor
) -> tb.Reconstruction:
    """Factors, then a photograph with factors made."""
    estimators = [tb.BRDFEstimator(basis, classes) for _ in range(3)]
    steps("factors, and a photograph", lambda k: estimators[k](photograph))
    return steps("one photograph", lambda _: estimators[0](photograph), 9)


def strangers(materials: int) -> column_sources.EmbeddedSource:
    """Materials whose logarithms lie between those of two embedded ones, drawn at random."""
    source = column_sources.EmbeddedSource()
    generator = torch.Generator().manual_seed(0)
    pairs = torch.randint(len(source.names), (2, materials), generator=generator)
    one, other = (source.factors.subset((3 * some[:, None] + torch.arange(3)).ravel()) for some in pairs)
    share = torch.rand(materials, generator=generator).repeat_interleave(3)
    between = share * one.quantised + (1 - share) * other.quantised
    source.factors = replace(one, quantised=between.round().short())
    source.names = tuple(f"material{i:03}" for i in range(materials))
    return source


AXES = {axis.__name__: axis for axis in (pixels, columns, photographs)}


def points(axis: str, size: int, inputs: Path, folder: Path) -> Iterator[Point]:
    """Of one size."""
    steps = Steps(axis, size)
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # few materials support fewer classes
        AXES[axis](size, inputs, folder, steps)
    yield from steps.points


def main() -> None:
    axis, size, inputs, folder, output = sys.argv[1:]
    found = [asdict(point) for point in points(axis, int(size), Path(inputs), Path(folder))]
    Path(output).write_text(json.dumps(found))


if __name__ == "__main__":
    main()
