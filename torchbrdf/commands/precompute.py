"""`torchbrdf precompute`: the harmonic transport of a library, ahead of its first use."""

import argparse

from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import add_library

EXAMPLES = (
    "torchbrdf precompute --library merl/",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Of which library."""
    add_library(parser)
    parser.add_argument(
        "--orthographic", action="store_true", help="leave out what photographs with --fov need: a third of the time"
    )


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Precompute the harmonic transport of a library: basis images of a ball then take a tenth of a second or two."""
    from time import perf_counter

    from torchbrdf.commands._inputs import open_library
    from torchbrdf.transport.harmonic import files_of, is_precomputed, transport_of

    library, perspective = open_library(options), not options.orthographic
    known, start = is_precomputed(library, perspective), perf_counter()
    transport_of(library, progress=True, perspective=perspective)
    seconds, files = perf_counter() - start, files_of(library, perspective)
    size = sum(file.stat().st_size for file in files)
    folders = ", ".join(sorted({str(file.parent) for file in files}))
    findings.line(
        f"ready for photographs of balls, {'with and without' if perspective else 'without'} --fov, by the library of "
        f"{len(library)} materials: {size / 1e6:.0f} MB in {folders}, "
        + ("which were there" if known else f"made in {seconds:.0f} s")
    )
    findings.add(materials=len(library), perspective=perspective, bytes=size, seconds=seconds)
    if not known:
        findings.add_files(*files)
    return 0
