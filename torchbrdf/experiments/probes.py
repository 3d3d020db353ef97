"""The probes of experiments: those beside a clone of the repository, and a turn that spoils them."""

from collections.abc import Sequence
from math import radians
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf.light import LightProbe

PROBES = ("apartment.exr", "venice.exr", "forest.exr", "dawn.exr", "uffizi.hdr", "grace.hdr", "ennis.hdr")
"""Those of ../shared/data/probes that differ: uffizi_angularmap* are Uffizi again, bad_nan_inf is broken."""

SHARED = Path("..", "shared", "data")
"""Where that data is, seen from the root of a clone, in which the scripts are run."""


def default_probes() -> list[Path]:
    """The files of PROBES."""
    return [SHARED / "probes" / name for name in PROBES]


def open_probe(path: str | Path) -> LightProbe:
    """A lat-long probe with its rows from pole to pole, wherever its file's are.

    So Mitsuba's `envmap` reads every file, and so did the experiments' first version: targets and published tables are
    those of the light that results, which need not be that of the place.
    """
    return LightProbe.open(path, rows="poles")


def open_probes(paths: Sequence[Path]) -> dict[str, LightProbe]:
    """Probes by the names of their files, each read once by `open_probe`. Raises ValueError where two share a name."""
    probes: dict[str, LightProbe] = {}
    for path in paths:
        if path.stem in probes:
            raise ValueError(f"{path}: another probe is called {path.stem}, too; rename one of the files")
        probes[path.stem] = open_probe(path)
    return probes


_AXIS = (1 / 3, 2 / 3, 2 / 3)


def tilt(degrees: float) -> Tensor:
    """(3, 3): the turn about the axis (1, 2, 2)."""
    x, y, z = _AXIS
    generator = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    return torch.linalg.matrix_exp(radians(degrees) * generator)
