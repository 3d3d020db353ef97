"""What benchmarks of photographs of measured materials share: what they are asked, and where errors and table go."""

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torchbrdf as tb
from torchbrdf.command_line import Parser
from torchbrdf.experiments import Experiment, default_probes, open_probes, read_targets, replace_results, write_rows

OBSERVED = ("forest", "uffizi", "grace")


def measured_options(parser: Parser) -> None:
    """Targets, lights, and what is written."""
    parser.add_argument("--targets", type=Path, required=True, help="folder that scripts/make_targets.py made")
    parser.add_argument("--observe", nargs="+", default=OBSERVED, help="probes of the photographs")
    parser.add_argument("--csv", type=Path, help="every error")
    parser.add_argument("--document", type=Path, help="page to write the table into")


def experiment_of(options: argparse.Namespace) -> Experiment:
    """The targets with the embedded library, under all probes."""
    return Experiment.of(tb.MaterialLibrary.default(), open_probes(default_probes()), read_targets(options.targets))


def publish(options: argparse.Namespace, errors: Sequence[Any], table: str, about: str = "") -> None:
    """Print a table; write errors, dataclasses of one kind, and what the page says of them, where that is asked for."""
    print(table)
    if options.csv:
        write_rows(options.csv, [asdict(one) for one in errors])
    if options.document:
        replace_results(options.document, about + table)
