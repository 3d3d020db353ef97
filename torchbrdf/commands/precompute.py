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
    from torchbrdf.commands._inputs import open_library
    from torchbrdf.transport.harmonic import transport_of

    transport = transport_of(open_library(options), progress=True, perspective=not options.orthographic)
    findings.line(f"ready: {transport!r}")
    findings.add(transport=repr(transport))
    return 0
