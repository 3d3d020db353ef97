"""`torchbrdf precompute`: the harmonic transport of a library, ahead of its first use."""

import argparse

from torchbrdf.commands.inputs import open_library
from torchbrdf.harmonic_cache import transport_of


def run(options: argparse.Namespace) -> int:
    """Precompute the harmonic transport of a library: basis images of a sphere then take a tenth of a second."""
    transport = transport_of(open_library(options), progress=True)
    print(f"ready: {transport!r}")
    return 0
