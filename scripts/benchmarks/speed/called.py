"""What `calls.py` times, by public names only: `python -m speed.called PART INPUTS OUTPUT REPEATS`, of any version.

Each part writes seconds by name into OUTPUT/seconds.json, and results beside it, from which errors are taken. A light
is never the same twice, by a factor of a thousandth: what a version keeps of an earlier one does not count.
"""

import json
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Literal, TypeVar

import torch
from torch import Tensor

import torchbrdf as tb
from speed.settings import HALF_AROUND, PROBES, RENDERED_UNDER, SIZE, TABLES

OFTEN = 10
"""Times as many repeats of what takes milliseconds."""

BATCH = 64

Seconds = dict[str, list[float]]
T = TypeVar("T")


def timed(work: Callable[[int], T], repeats: int) -> tuple[list[float], T]:
    """Seconds of work(1), work(2), ..., after a warm-up; and what work(0), the warm-up, gave."""
    first = work(0)
    seconds = []
    for k in range(1, repeats + 1):
        start = time.perf_counter()
        work(k)
        seconds.append(time.perf_counter() - start)
    return seconds, first


def changed(probe: tb.LightProbe, k: int) -> tb.LightProbe:
    """A light that was not seen before; the probe's own for 0."""
    return tb.LightProbe(probe.radiance * (1 + 1e-3 * k))


def opened(inputs: Path, name: str) -> tb.LightProbe:
    return tb.LightProbe.open(inputs / f"{name}.exr")


def shown(weights: Tensor, library: tb.MaterialLibrary, inputs: Path) -> Tensor:
    """(B, 3, H, W) of weights (B, n, 3) under the light turned by half, by samples, which no row is about.

    Each version shows its own: its library need not be the other's.
    """
    novel = opened(inputs, "default").rotated(torch.diag(torch.tensor(HALF_AROUND)))
    basis = tb.render_basis(library, novel, tb.SphereView(SIZE), backend="sampled")
    return basis.unpack(torch.einsum("nsp,bns->bsp", basis.packed, weights.float()).clamp_min(0))


def solving(inputs: Path, output: Path, repeats: int) -> Seconds:
    """Factors made, and what goes on from there."""
    library, view, probe = tb.MaterialLibrary.default(progress=False), tb.SphereView(SIZE), opened(inputs, "default")
    classes = tb.MaterialClasses.fit(library)
    bases = [tb.render_basis(library, changed(probe, k), view) for k in range(repeats + 1)]
    photographs = torch.load(inputs / "photographs.pt")[:BATCH]
    estimator, seconds = tb.BRDFEstimator(bases[0], classes), Seconds()
    seconds["one"], _ = timed(lambda _: estimator(photographs[0]), OFTEN * repeats)
    seconds["batch"], together = timed(lambda _: estimator(photographs), repeats)
    seconds["factors"], _ = timed(lambda k: tb.BRDFEstimator(bases[k], classes)(photographs[0]), repeats)
    result = estimator(photographs[0])
    seconds["brdf"], _ = timed(lambda _: result.brdf(library), repeats)
    weights = torch.linspace(-0.1, 1, 3 * library.n).reshape(library.n, 3).roll(7, 0) ** 9
    library.combine(weights).save(output / "combined.binary")
    torch.save(weights, output / "combined.pt")
    torch.save(shown(together.weights, library, inputs), output / "batch.pt")
    return seconds


def looped(inputs: Path, output: Path, repeats: int) -> Seconds:
    """What solver.py measures the estimator against: the fastest of LAPACK's drivers, class by class."""
    from solver import DRIVERS, solve_and_judge

    library, view = tb.MaterialLibrary.default(progress=False), tb.SphereView(SIZE)
    basis = tb.render_basis(library, opened(inputs, "default"), view)
    classes = tb.MaterialClasses.fit(library)
    columns = {j: basis.packed[classes.members(j)].double() for j in range(classes.n_classes)}
    y = basis.pack(torch.load(inputs / "photographs.pt")[0]).double()

    def solved(driver: str, _: int) -> list[Tensor]:
        return solve_and_judge(columns, y, driver)

    found = {driver: timed(partial(solved, driver), repeats)[0] for driver in DRIVERS}
    return {"looped": min(found.values(), key=lambda seconds: sorted(seconds)[len(seconds) // 2])}


def lighting(inputs: Path, output: Path, repeats: int) -> Seconds:
    """A new light: to the basis images, and to the reconstruction."""
    library, view = tb.MaterialLibrary.default(progress=False), tb.SphereView(SIZE)
    classes, photograph = tb.MaterialClasses.fit(library), torch.load(inputs / "photographs.pt")[0]
    seconds = Seconds()

    def basis(probe: tb.LightProbe, k: int) -> tb.BasisImages:
        return tb.render_basis(library, changed(probe, k), view)

    for name in PROBES:
        if (inputs / f"{name}.exr").is_file():
            probe = opened(inputs, name)
            seconds[f"basis {name}"], first = timed(partial(basis, probe), repeats)
            torch.save(first.packed, output / f"basis-{name}.pt")
    probe = opened(inputs, "default")
    seconds["reconstruction"], weights = timed(
        lambda k: tb.BRDFEstimator(basis(probe, k), classes)(photograph).weights, repeats
    )
    torch.save(shown(weights[None], library, inputs), output / "reconstruction.pt")
    return seconds


def rendering(inputs: Path, output: Path, repeats: int) -> Seconds:
    """One table each, small: pictures of one that was shown before, and of tables that were not."""
    view, seconds = tb.SphereView(SIZE), Seconds()
    for light in RENDERED_UNDER:
        probe = opened(inputs, light)
        for name in TABLES:
            table = tb.MerlTable.open(inputs / f"{name}.binary")

            fresh = [tb.MerlTable(table.values, table.valid) for _ in range(repeats + 1)]

            def image(k: int, tables: Sequence[tb.MerlTable], probe: tb.LightProbe = probe) -> Tensor:
                return tb.render(tables[k], changed(probe, k), view)

            seconds[f"first {name}, {light}"], first = timed(partial(image, tables=fresh), repeats)
            again = [table] * (repeats + 1)
            seconds[f"render {name}, {light}"], _ = timed(partial(image, tables=again), repeats)
            torch.save(first, output / f"render-{name}-{light}.pt")
    return seconds


def aligning(inputs: Path, output: Path, repeats: int) -> Seconds:
    """Photographs of balls under a turned light."""
    library, view, probe = tb.MaterialLibrary.default(progress=False), tb.SphereView(SIZE), opened(inputs, "default")
    seconds = Seconds()
    searches: tuple[Literal["near", "full"], ...] = ("near", "full")
    for search in searches:
        photograph = torch.load(inputs / f"{search}.pt")

        def found(k: int, photograph: Tensor = photograph, search: Literal["near", "full"] = search) -> Tensor:
            return tb.align(photograph * (1 + 1e-3 * k), changed(probe, k), view, library, search=search).rotation

        seconds[f"align {search}"], first = timed(found, repeats)
        torch.save(first, output / f"align-{search}.pt")
    return seconds


PARTS = {part.__name__: part for part in (solving, looped, lighting, rendering, aligning)}


def main() -> None:
    name, inputs, output, repeats = sys.argv[1:]
    with torch.no_grad():
        seconds = PARTS[name](Path(inputs), Path(output), int(repeats))
    (Path(output) / "seconds.json").write_text(json.dumps(seconds))


if __name__ == "__main__":
    main()
