"""`torchbrdf precompute`: the harmonic transport of a library, ahead of its first use."""

import argparse

from torchbrdf.commands._options import add_library


def add_options(parser: argparse.ArgumentParser) -> None:
    """Of which library."""
    add_library(parser)


def run(options: argparse.Namespace) -> int:
    """Precompute the harmonic transport of a library: basis images of a sphere then take a tenth of a second."""
    from torchbrdf.commands._inputs import open_library
    from torchbrdf.transport.harmonic import transport_of

    transport = transport_of(open_library(options), progress=True)
    print(f"ready: {transport!r}")
    return 0
