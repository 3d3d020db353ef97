"""`torchbrdf classes`: which material is in which class."""

import argparse

from torchbrdf.classes import MaterialClasses
from torchbrdf.commands.inputs import open_library


def run(options: argparse.Namespace) -> int:
    """Print the material classes of a library."""
    print(MaterialClasses.fit(open_library(options), options.n_classes, options.n_dims).table())
    return 0
