#!/usr/bin/env python3
"""Claim: `ReflectanceMaps` makes training samples faster than a small network on the same cores can take them.

    python scripts/benchmarks/dataset.py

Samples a second for numbers of workers and batch sizes, without defects and with `augment.photograph_defects`; median
and range of the repeats, after a warm-up. Beside them a naive rival: the table B w of every sample, rendered by
`torchbrdf.render`; the last line says how far its images are from ours, which is the noise of its samples and ours.
And what training takes: steps of the network of scripts/train_denoiser.py, estimator included.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import torch
from torch.utils.data import BatchSampler, DataLoader, SequentialSampler
from tqdm import tqdm

import torchbrdf as tb
from torchbrdf.command_line import Parser, exit_status
from torchbrdf.experiments import Restorer, relative
from torchbrdf.learning import ReflectanceMaps, photograph_defects


@dataclass(frozen=True)
class Rate:
    """Samples a second: median, least and largest of the repeats."""

    median: float
    low: float
    high: float

    def __str__(self) -> str:
        """A cell of the table."""
        digits = 0 if self.low >= 10 else 2
        return f"{self.median:.{digits}f} ({self.low:.{digits}f} to {self.high:.{digits}f})"


def rate_of(make: Callable[[], int], seconds: float, repeats: int) -> Rate:
    """How many samples make() makes a second; each repeat takes some seconds or one call."""
    make()
    rates = []
    for _ in range(repeats):
        start, count = time.perf_counter(), 0
        while count == 0 or time.perf_counter() - start < seconds:
            count += make()
        rates.append(count / (time.perf_counter() - start))
    return Rate(statistics.median(rates), min(rates), max(rates))


def loader_rate(maps: ReflectanceMaps, batch: int, workers: int, options: argparse.Namespace) -> Rate:
    sampler = BatchSampler(SequentialSampler(maps), batch, True)
    loader = DataLoader(maps, None, sampler=sampler, num_workers=workers)

    def batches() -> Iterator[int]:
        while True:
            for found in loader:
                yield len(found["image"])

    running = batches()
    for _ in range(2 * workers):  # what was made ahead, while the workers started, is no rate
        next(running)
    return rate_of(lambda: next(running), options.seconds, options.repeats)


def naive_rate(
    library: tb.MaterialLibrary, probe: tb.LightProbe, maps: ReflectanceMaps, view: tb.View, options: argparse.Namespace
) -> tuple[Rate, float]:
    """Of rendering every sample's table; and the median difference of its images from ours."""
    batch = maps[list(range(options.repeats + 1))]
    count, differences = iter(range(options.repeats + 1)), []

    def make() -> int:
        i = next(count)
        image = tb.render(library.combine(batch["weights"][i]), probe, view, seed=1)
        differences.append(float(relative(image[None], batch["clean"][i][None])))
        return 1

    return rate_of(make, 0, options.repeats), statistics.median(differences)


def training_rate(
    estimator: tb.BRDFEstimator, view: tb.View, maps: ReflectanceMaps, options: argparse.Namespace
) -> Rate:
    restorer = Restorer(estimator, view)
    optimiser = torch.optim.AdamW(restorer.parameters())
    batch = maps[list(range(16))]

    def step() -> int:
        loss = relative(restorer.estimate(restorer(batch["image"])).image, batch["clean"]).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        return 16

    return rate_of(step, options.seconds, options.repeats)


def run(options: argparse.Namespace) -> None:
    library = tb.MaterialLibrary.default()
    probe, view = tb.LightProbe.default(), tb.SphereView(options.size)
    basis = tb.render_basis(library, probe, view)
    clean, spoilt = ReflectanceMaps(basis), ReflectanceMaps(basis, photograph_defects(view))
    kinds = {"clean": clean, "with defects": spoilt}
    lines = []
    for what, batch in tqdm([(what, batch) for what in kinds for batch in options.batches]):
        rates = [loader_rate(kinds[what], batch, workers, options) for workers in options.workers]
        lines.append(f"| {what}, {batch} at a time | {' | '.join(map(str, rates))} |")
    naive, difference = naive_rate(library, probe, clean, view, options)
    training = training_rate(tb.BRDFEstimator(basis, tb.MaterialClasses.fit(library)), view, spoilt, options)
    print(f"{options.size} x {options.size}, n = {library.n}, {torch.get_num_threads()} threads\n")
    print(f"| samples a second | {' | '.join(f'{workers} workers' for workers in options.workers)} |")
    print("\n".join(["|---|" + "---:|" * len(options.workers), *lines]))
    print(f"\nrendered one by one: {naive}\ntraining, 16 at a time: {training}")
    print(f"images rendered one by one differ by {100 * difference:.2f} % (median)")


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--size", type=int, default=32, help="pixels along a side, a multiple of 4")
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 16, 64, 256])
    parser.add_argument("--workers", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--seconds", type=float, default=1.0, help="of each repeat")
    parser.add_argument("--repeats", type=int, default=5)
    return exit_status("dataset", run, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
