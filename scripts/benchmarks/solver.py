#!/usr/bin/env python3
"""Claim: an RGB image of 64 x 64, all classes and priors, takes at most 5 ms, 20 times less than looped least squares.

    GOMP_SPINCOUNT=5000 python scripts/benchmarks/solver.py [--library DIR] [--probe FILE] [--device cuda]

The basis is factored before, except where a row says otherwise. The rival is `torch.linalg.lstsq` with each of its
drivers in float64 on the augmented system [Y; sqrt(lambda) I], for the paper's lambda, one class and colour channel at
a time: the light has a colour, so every channel has basis images of its own, and the channels cannot be right sides
of one system. "looped" is its way from basis images to the class that is chosen; "solves" leaves out building the
systems and judging the classes. The default averages 37 priors with 9 penalties where the rival solves for 4 with one.
Photographs: renderings of materials of the library with noise.

Every row: median over the repeats after a warm-up, from the 10th to the 90th percentile, in ms a photograph; beside it
the relative RMS difference of the fitted image and of a re-rendering under another light (the same turned by 180
degrees) to the row that the part calls its reference.
"""

import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

import torchbrdf as tb
from solver_scene import Row, Scene
from torchbrdf.brdf import N_CELLS
from torchbrdf.command_line import Parser
from torchbrdf.estimation import PAPER_PENALTY, ImageSpace, Penalty, Reconstruction, image_space
from torchbrdf.estimation.priors import Explanation, PriorBank
from torchbrdf.estimation.solvers import GramFactor, balance, prior_mean, ridge
from torchbrdf.transport import plan_transport

DRIVERS = ("gels", "gelsy", "gelsd", "gelss")
PENALTIES: tuple[Penalty, ...] = ("auto", "paper")
BATCHES = (1, 4, 16, 64, 256)
CUTS = (1e-7, 1e-6, 1e-5, 5e-5, 5e-4, 5e-3)
"""Truncations; the first is the reference of all others."""
KEPT = {"1 % left out": 0.99, "half left": 0.5, "1 % left": 0.01}
LEAST = (1e-2, 1e-4, 1e-12)
MARGIN = 1e-3


def against_lstsq(scene: Scene) -> Iterator[Row]:
    """One photograph against looped least squares; the fixed penalty of this estimator is the error's reference."""
    image, y, paper = scene.photographs[0].double(), scene.pixels(1)[0], scene.estimator(penalty="paper")
    expected = paper(image).class_weights
    columns = {j: scene.basis.packed[scene.classes.members(j)].double() for j in range(scene.classes.n_classes)}
    systems = list(augmented(columns, y))
    fastest = {"solves": float("inf"), "looped": float("inf")}
    for driver in DRIVERS:
        ways = {"solves": partial(solve, systems, driver), "looped": partial(solve_and_judge, columns, y, driver)}
        for name, way in ways.items():
            row = Row("one image", f"lstsq, {driver}, {name}", scene.timed(way))
            found = torch.zeros_like(expected)
            for (j, s, *_), weights in zip(systems, way(), strict=True):
                found[j, scene.classes.members(j), s] = weights
            yield row.noted(scene.apart(found, expected), f"{len(systems)} systems: all classes, RGB")
            fastest[name] = min(fastest[name], row.median)
    default, single = scene.estimator(), scene.photographs[0]
    for name, estimator, one in (("fixed penalty, factored", paper, image), ("default, float32", default, single)):
        row = Row("one image", name, scene.timed(partial(estimator, one)))
        apart = scene.apart(estimator(one).weights[None], estimator(image).weights[None])
        ratios = [f"{fastest[key] / row.median:.1f} x the fastest {key}" for key in ("looped", "solves")]
        yield row.noted(apart, ", ".join(ratios))


def solve(systems: Sequence[tuple[int, int, Tensor, Tensor]], driver: str) -> list[Tensor]:
    """The weights of every class and channel."""
    return [torch.linalg.lstsq(system, target, driver=driver).solution[:, 0] for *_, system, target in systems]


def solve_and_judge(columns: dict[int, Tensor], y: Tensor, driver: str) -> list[Tensor]:
    """The same from the basis images, and the residuals that choose a class."""
    weights, errors = [], dict.fromkeys(columns, 0.0)
    for j, s, system, target in augmented(columns, y):
        found = torch.linalg.lstsq(system, target, driver=driver).solution[:, 0]
        errors[j] += float((columns[j][:, s].T @ found - y[s]).square().sum())
        weights.append(found)
    return weights


def augmented(columns: dict[int, Tensor], y: Tensor) -> Iterator[tuple[int, int, Tensor, Tensor]]:
    """Class, channel, [Y; sqrt(lambda) I] and [y; sqrt(lambda) mu'] for a photograph (3, P); columns (c, 3, P)."""
    for j, basis in columns.items():
        root = balance(PAPER_PENALTY, y.square().sum(-1), len(basis)).sqrt()
        prior = prior_mean(len(basis), like=y)
        for s in range(3):
            system = torch.cat([basis[:, s].T, root[s] * torch.eye(len(basis), dtype=torch.float64)])
            yield j, s, system, torch.cat([y[s], root[s] * prior])[:, None]


def batches(scene: Scene) -> Iterator[Row]:
    """Photographs together; the reference is each alone."""
    for name in PENALTIES:
        estimator, first = scene.estimator(penalty=name), 0.0
        for count in (b for b in BATCHES if b <= len(scene.photographs)):
            some = scene.photographs[:count]
            row = Row("batches", f'"{name}", {count}', scene.timed(partial(estimator, some)), count)
            first = first or row.median
            alone = torch.stack([estimator(one).weights for one in some[:4]])
            apart = scene.apart(estimator(some).weights[:4], alone)
            yield row.noted(apart, f"{first / row.median:.1f} x cheaper than alone")


def factors(scene: Scene) -> Iterator[Row]:
    """A new light: from basis images to the first answer."""
    for name in PENALTIES:

        def fresh(penalty: Penalty = name) -> Reconstruction:
            return tb.BRDFEstimator(scene.basis, scene.classes, penalty)(scene.photographs[0])

        yield Row("new light", f'"{name}": factors and the first image', scene.timed(fresh))


def masks(scene: Scene) -> Iterator[Row]:
    """Updating the factors against forming them anew from the cropped basis images, the reference."""
    bank, g = scene.estimator().bank, torch.Generator().manual_seed(1)
    pixels = scene.basis.packed.shape[-1]
    for name, share in KEPT.items():
        used = torch.zeros(pixels, dtype=torch.bool)
        used[torch.randperm(pixels, generator=g)[: max(1, round(share * pixels))]] = True
        cropped = scene.basis.packed[..., used]
        anew = Row("mask", f"{name}, anew", scene.timed(partial(of_cropped, cropped, bank.space, used)))
        update = Row("mask", f"{name}, updated", scene.timed(partial(bank.space.masked, used)))
        y = scene.pixels(8)[..., used]
        weights = [
            mean_weights(PriorBank.of(space, bank.variances).explain(y))
            for space in (bank.space.masked(used), of_cropped(cropped, bank.space, used))
        ]
        yield replace(anew, fitted=0.0, novel=0.0)
        yield update.noted(scene.apart(*weights), f"{anew.median / update.median:.1f} x")
        yield Row("mask", f"{name}, updated, with all priors", scene.timed(partial(bank.masked, used)))


def of_cropped(cropped: Tensor, whole: ImageSpace, used: Tensor) -> ImageSpace:
    return ImageSpace.weighted(cropped, whole.scale[:, used])


def mean_weights(found: Explanation, least: float = 0.0) -> Tensor:
    """Posterior mean (B, n, 3); of priors more probable than `least` only."""
    shares = found.shares
    if least:
        keep = torch.nonzero((shares.sum(-1) > least).any(0)).ravel()
        found, shares = some_priors(found, keep), shares[:, keep]
        shares = shares / shares.sum((1, 2), keepdim=True)
    return found.components(shares).sum(1).mT


def some_priors(found: Explanation, keep: Tensor) -> Explanation:
    bank = found.bank
    parts = {f.name: getattr(bank, f.name)[keep] for f in fields(bank) if f.name not in ("space", "correlation")}
    own = {f.name: getattr(found, f.name)[:, keep] for f in fields(found) if f.name != "bank"}
    return replace(found, bank=replace(bank, **parts), **own)


def truncation(scene: Scene) -> Iterator[Row]:
    """Directions below the noise."""
    some, default, reference = scene.photographs[:16].double(), image_space.CUT, None
    try:
        for cut in CUTS:
            image_space.CUT = cut
            estimator = scene.estimator()
            weights = estimator(some).weights
            reference = weights if reference is None else reference
            rank = estimator.bank.space.u.shape[-1]
            space = scene.timed(lambda: ImageSpace.of(scene.basis.packed, [scene.basis.packed.shape[-1]]))
            bank = scene.timed(partial(PriorBank.of, estimator.bank.space, estimator.bank.variances))
            total = 1e3 * (statistics.median(space) + statistics.median(bank))
            row = Row("truncation", f"CUT = {cut:.0e}", scene.timed(partial(estimator, scene.photographs[0])))
            remark = f"{rank} directions, factors {total:.0f} ms" + (", the default" if cut == default else "")
            yield row.noted(scene.apart(weights, reference), remark)
    finally:
        image_space.CUT = default


def precision(scene: Scene) -> Iterator[Row]:
    """Photographs and their projection in float32 and float64, the reference."""
    estimator, some = scene.estimator(), scene.photographs[:16]
    reference = estimator(some.double()).weights
    for dtype in (torch.float64, torch.float32):
        batch = some.to(dtype)
        row = Row("precision", f"{dtype}".removeprefix("torch."), scene.timed(partial(estimator, batch)), len(some))
        yield row.noted(scene.apart(estimator(batch).weights, reference))


def skipped_priors(scene: Scene) -> Iterator[Row]:
    """From evidence to weights: all priors, the reference, and those probable for one of the photographs only."""
    bank = scene.estimator().bank
    for count in (1, 16):
        with torch.no_grad():
            found = bank.explain(scene.pixels(count))
        whole = Row("priors", f"all, {count} images", scene.timed(partial(mean_weights, found)), count)
        yield replace(whole, fitted=0.0, novel=0.0, remark=f"{len(bank.variances)} priors")
        for least in LEAST:
            row = Row("priors", f"above {least:.0e}", scene.timed(partial(mean_weights, found, least)), count)
            apart = scene.apart(mean_weights(found, least), mean_weights(found))
            yield row.noted(apart, f"{whole.median - row.median:.3f} ms less")


def skipped_classes(scene: Scene) -> Iterator[Row]:
    """The fixed penalty: a class cannot win whose residual without any penalty is above the best so far."""
    members = [scene.classes.members(j) for j in range(scene.classes.n_classes)]
    bases = [scene.basis.packed[rows].double() for rows in members]
    solved = [GramFactor.of(basis) for basis in bases]
    photographs = scene.pixels(16)

    def winners(skip: bool) -> tuple[list[int], int]:
        best, solves = [], 0
        for y in photographs:
            energy = y.square().sum(-1)
            projections = [torch.einsum("nsp,sp->sn", basis, y) for basis in bases]
            bounds = [0.0] * len(bases)
            if skip:
                bounds = [lower_bound(f, p, energy) for f, p in zip(solved, projections, strict=True)]
            errors: dict[int, float] = {}
            for j in sorted(range(len(bases)), key=bounds.__getitem__):
                if errors and bounds[j] >= min(errors.values()):
                    break
                prior, strength = prior_mean(len(members[j]), like=y), balance(PAPER_PENALTY, energy, len(members[j]))
                weights = ridge(solved[j], projections[j], prior, strength)
                errors[j] = float((torch.einsum("nsp,sn->sp", bases[j], weights) - y).square().sum())
            best.append(min(errors, key=errors.__getitem__))
            solves += len(errors)
        return best, solves

    whole = Row("classes", "all solved", scene.timed(lambda: winners(False)), len(photographs))
    yield replace(whole, fitted=0.0, novel=0.0, remark="fixed penalty, one photograph at a time")
    row = Row("classes", "those that can win", scene.timed(lambda: winners(True)), len(photographs))
    (expected, total), (found, solves) = winners(False), winners(True)
    same = sum(a == b for a, b in zip(expected, found, strict=True))
    yield replace(row, remark=f"{solves} of {total} solves; the same winner in {same} of {len(found)}")


def lower_bound(factor: GramFactor, projection: Tensor, energy: Tensor) -> float:
    """|y|^2 less the energy of its projection on the span of a class, a little below for rounding."""
    rotated = (factor.vectors.mT @ projection[..., None])[..., 0]
    kept = factor.values > 1e-12 * factor.values[:, :1]
    inside = torch.where(kept, rotated.square() / torch.where(kept, factor.values, 1), 0).sum(-1)
    return float((energy - inside).sum() * (1 - MARGIN))


def light_and_cells(scene: Scene, samples: int) -> Iterator[Row]:
    """Basis images: texels without energy are not drawn, cells that no sample touches are not read."""
    radiance = scene.probe.radiance
    level = radiance.sum(0).flatten().quantile(0.9)
    lamps = tb.LightProbe(torch.where(radiance.sum(0) >= level, radiance, 0))
    for name, probe in (("the whole light", scene.probe), ("its brightest tenth, the rest black", lamps)):
        start = time.perf_counter()
        plan = plan_transport(scene.library.stored.columns, probe, scene.view, samples, 0)
        touched, drawn, lost = torch.zeros(N_CELLS, dtype=torch.bool), 0, 0
        for _, transport in plan.blocks():
            touched[transport.cells.flatten().long()] = True
            drawn += transport.cells.numel()
            lost += int((transport.weights == 0).all(0).sum())
        remark = (
            f"{float(touched.float().mean()):.0%} of the cells touched, {lost / drawn:.0%} of the samples without light"
        )
        yield Row("basis", name, [time.perf_counter() - start], remark=f"{remark}; once, samples only")


def memory(library: Path | None, size: int, samples: int) -> Iterator[Row]:
    """Peak memory of `render_basis` in a process of its own; pages of the mapped library can be given back."""
    opened = f"tb.MaterialLibrary.from_files({str(library or 'default')!r})"
    code = (
        f"import torchbrdf as tb\nlibrary = {opened}\n"
        f"tb.render_basis(library, tb.LightProbe.default(), tb.SphereView({size}), samples={samples})\n"
        "lines = dict(line.split(':') for line in open('/proc/self/status'))\n"
        "print(*(int(lines[key].split()[0]) for key in ('VmHWM', 'RssFile', 'RssAnon')))\n"
        "print(library.stored.columns.nbytes)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    peak, mapped, own = (int(value) / 2**10 for value in out[:3])
    remark = f"peak {peak:.0f} MiB, at the end {mapped:.0f} of files, {own:.0f} of its own"
    yield Row("basis", f"memory, library of {int(out[3]) / 2**20:.0f} MiB", remark=remark)


def on_cuda(scene: Scene) -> Iterator[Row]:
    """The same on the accelerator; the reference is the CPU."""
    some = scene.photographs[:64]
    for name in PENALTIES:
        expected = scene.estimator(penalty=name)(some).weights
        there = tb.BRDFEstimator(scene.basis.to("cuda"), scene.classes, penalty=name)
        for count in (1, len(some)):
            batch = some[:count].cuda()

            def work(batch: Tensor = batch, there: tb.BRDFEstimator = there) -> Tensor:
                weights = there(batch).weights
                torch.cuda.synchronize()
                return weights

            row = Row("CUDA", f'"{name}", {count}', scene.timed(work), count)
            yield row.noted(scene.apart(work().cpu(), expected[:count]), "error: to the CPU")


def measure(scene: Scene, samples: int, device: str) -> Iterator[Row]:
    """All parts but the memory of another process."""
    with torch.no_grad():
        for part in (against_lstsq, batches, factors, masks, truncation, precision, skipped_priors, skipped_classes):
            yield from part(scene)
        yield from light_and_cells(scene, samples)
        if device == "cuda" and torch.cuda.is_available():
            yield from on_cuda(scene)
        else:
            yield Row("CUDA", "not run")


def table(rows: Sequence[Row]) -> str:
    """Markdown."""
    head = ["part", "what", "ms a photograph", "10-90 %", "fitted", "novel light", "remark"]
    lines = [head, ["---", "---", "---:", "---:", "---:", "---:", "---"], *(row.cells() for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main(argv: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = Parser.of_script(__doc__)
    parser.add_argument("--library", type=Path, help="directory of MERL files; default: the embedded library")
    parser.add_argument("--probe", type=Path, help="lat-long image; default: the built-in light")
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--samples", type=int, default=4096, help="of the basis images, a pixel")
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    options = parser.parse_args(argv)
    library = tb.MaterialLibrary.from_files(options.library or "default")
    probe = tb.LightProbe.open(options.probe, rows="poles") if options.probe else tb.LightProbe.default()
    scene = Scene.of(library, probe, options.size, options.samples, options.repeats)
    rows = [*measure(scene, options.samples, options.device), *memory(options.library, options.size, options.samples)]
    print(f"{library!r}, {probe!r}, {torch.get_num_threads()} threads, {options.repeats} repeats\n")
    print(table(rows))


if __name__ == "__main__":
    main()
