#!/usr/bin/env python3
"""Claim: at the default sample count 95 % of the basis images are within 0.5 % of converged ones, in about 2 s.

    python scripts/benchmarks/transport_error.py [--library DIR] [--probes FILE ...] [--repeats N]

Renders the basis under the default probe and those in the given files, at several sample counts, against a run
of many more samples with another seed. The rival gives every pixel as many samples (adaptive=False). Error of a
basis image: sqrt(sum of squared differences / sum of squares) over pixels and RGB. Seconds: the median of the
repeats after a warm-up, sampling included, by the clock and of processor time; other load lengthens the first.
"""

import statistics
import time
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf import LightProbe, MaterialLibrary, SphereView, render_basis
from torchbrdf.command_line import Parser
from torchbrdf.experiments import SHARED
from torchbrdf.transport import DEFAULT_SAMPLES

PROBES = SHARED / "probes"
REFERENCE_SEED = 12345


def main() -> None:
    """Print the table."""
    parser = Parser.of_script(__doc__)
    parser.add_argument("--library", type=Path, help="directory of MERL files; default: the embedded library")
    parser.add_argument("--probes", type=Path, nargs="*", help="probe files; default: grace, ennis, uffizi if there")
    parser.add_argument("--samples", type=int, nargs="+", default=[1024, 2048, DEFAULT_SAMPLES])
    parser.add_argument("--reference-samples", type=int, default=32768)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()

    files = arguments.probes
    if files is None:
        files = [path for name in ("grace", "ennis", "uffizi") if (path := PROBES / f"{name}.hdr").is_file()]
    library = MaterialLibrary.from_files(arguments.library or "default")
    view = SphereView(arguments.size)
    threads = torch.get_num_threads()
    print(f"{library!r}, {view!r}, {threads} threads, reference: {arguments.reference_samples} samples a pixel\n")
    print("| probe | samples a pixel | seconds | processor seconds | median error | 95 % within | worst |")
    print("|---|---|---|---|---|---|---|")
    probes = {"default": LightProbe.default()} | {path.stem: LightProbe.open(path, rows="poles") for path in files}
    for name, probe in probes.items():
        reference = render_basis(
            library, probe, view, samples=arguments.reference_samples, seed=REFERENCE_SEED
        ).packed
        for samples, adaptive in [(n, True) for n in arguments.samples] + [(max(arguments.samples), False)]:
            packed, clock, processor = measure(library, probe, view, samples, adaptive, arguments.repeats)
            errors = relative_errors(packed, reference)
            median, most, worst = (100 * float(errors.quantile(q)) for q in (0.5, 0.95, 1.0))
            label = f"{samples}" + ("" if adaptive else ", equal")
            print(
                f"| {name} | {label} | {clock:.2f} | {processor:.2f} | {median:.2f} % | {most:.2f} % | {worst:.2f} % |",
                flush=True,
            )


def measure(
    library: MaterialLibrary, probe: LightProbe, view: SphereView, samples: int, adaptive: bool, repeats: int
) -> tuple[Tensor, float, float]:
    """Basis images (n, 3, P), seconds and seconds of processor time, each the median of the repeats."""
    clocks, processors = [], []
    for seed in range(repeats + 1):  # the first is the warm-up
        fresh = LightProbe(probe.radiance)  # without what an earlier run prepared
        begin = time.perf_counter(), time.process_time()
        packed = render_basis(library, fresh, view, samples=samples, seed=seed, adaptive=adaptive).packed
        clocks.append(time.perf_counter() - begin[0])
        processors.append(time.process_time() - begin[1])
    return packed, statistics.median(clocks[1:]), statistics.median(processors[1:])


def relative_errors(packed: Tensor, reference: Tensor) -> Tensor:
    """(n,): of each basis image that is not black."""
    energy = reference.double().square().sum((1, 2))
    lit = energy > 0
    return ((packed - reference).double().square().sum((1, 2))[lit] / energy[lit]).sqrt()


if __name__ == "__main__":
    main()
