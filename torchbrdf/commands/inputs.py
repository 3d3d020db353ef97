"""What several commands read: probes, libraries, and messages that name the file."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from torchbrdf.library import MaterialLibrary
from torchbrdf.probe import LightProbe


def open_probe(options: argparse.Namespace) -> LightProbe:
    """The probe of `--probe`, `--probe-layout` and `--repair-probe`."""
    if options.probe == "default":
        return LightProbe.default()
    return LightProbe.open(options.probe, layout=options.probe_layout, repair=options.repair_probe)


def open_library(options: argparse.Namespace) -> MaterialLibrary:
    """The library of `--library`, else the embedded one."""
    return MaterialLibrary.default() if options.library is None else MaterialLibrary.from_merl(options.library)


@contextmanager
def about(path: Path) -> Iterator[None]:
    """Put the file's name before the message of a ValueError."""
    try:
        yield
    except ValueError as error:
        message = str(error)
        raise ValueError(message if str(path) in message else f"{path}: {message}") from None
