"""`torchbrdf classes`: which material is in which class."""

import argparse

from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import add_library, whole_number
from torchbrdf.estimation import N_CLASSES, N_DIMS

EXAMPLES = (
    "torchbrdf classes",
    "torchbrdf classes --library merl/ --n-classes 3",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Of which library, and how many."""
    add_library(parser)
    parser.add_argument("--n-classes", type=whole_number(1), default=N_CLASSES, help="K; default: %(default)s")
    parser.add_argument("--n-dims", type=whole_number(1), default=N_DIMS, help="N; default: %(default)s")


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Print the material classes of a library."""
    from torchbrdf.commands._inputs import open_library
    from torchbrdf.estimation import MaterialClasses

    classes = MaterialClasses.fit(open_library(options), options.n_classes, options.n_dims)
    findings.line(classes.table())
    materials = {name: classes.labels[3 * i : 3 * i + 3] for i, name in enumerate(classes.names)}
    findings.add(sizes=classes.sizes, classes_of_materials=materials)
    return 0
