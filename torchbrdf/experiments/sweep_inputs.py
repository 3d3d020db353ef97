"""What the tasks of a sweep read: opened once by each process, and checked to be what the sweep was started with."""

import argparse
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from torchbrdf.brdf import MaterialLibrary
from torchbrdf.experiments.probes import open_probe, open_probes
from torchbrdf.light import LightProbe
from torchbrdf.transport.harmonic import HarmonicBasis
from torchbrdf.view import SphereView


def sweep_options(parser: argparse.ArgumentParser) -> None:
    """Where a sweep computes."""
    parser.add_argument("--processes", type=int, default=2, help="on this machine; default: 2")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="compute on the workers of a Dask scheduler")


@dataclass(frozen=True)
class SweepInputs:
    """What the tasks of a sweep over targets read: the library and the probes under which targets were made.

    library   opened; probes: name -> fingerprint
    places    where they lie, for `Task.places`
    """

    library: MaterialLibrary
    probes: Mapping[str, str]
    places: Mapping[str, Any]

    @classmethod
    def open(cls, library: Path | None, folder: Path, names: set[str]) -> "SweepInputs":
        """The embedded library for None, and probes by name in a folder. Raises ValueError where one is missing."""
        paths = {path.stem: path for path in sorted(folder.glob("*")) if path.stem in names}
        missing = names - set(paths)
        if missing:
            raise ValueError(f"{folder}: no probe {', '.join(sorted(missing))} here, under which targets were made")
        opened = MaterialLibrary.from_merl(library) if library else MaterialLibrary.default()
        places = {
            "library_path": str(library.resolve()) if library else "default",
            "probe_paths": {name: str(path.resolve()) for name, path in paths.items()},
        }
        probes = {name: probe.fingerprint for name, probe in open_probes(list(paths.values())).items()}
        return cls(opened, probes, places)


@lru_cache(maxsize=2)
def open_library(path: str, source: str) -> MaterialLibrary:
    """`default` or a folder of tables; source as `MaterialLibrary.source`."""
    library = MaterialLibrary.default() if path == "default" else MaterialLibrary.from_merl(path)
    if library.source != source:
        raise ValueError(f"{path}: holds other tables than when the sweep was started")
    return library


def swept_probe(path: str, fingerprint: str) -> LightProbe:
    """`default` or a file, as `open_probe` reads it. Raises ValueError where a sweep started with another."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # the process that made the tasks has said it
        probe = LightProbe.default() if path == "default" else open_probe(path)
    if probe.fingerprint != fingerprint:
        raise ValueError(f"{path}: another light probe than when the sweep was started")
    return probe


@lru_cache(maxsize=16)
def light_under(library: MaterialLibrary, path: str, fingerprint: str, size: int) -> HarmonicBasis:
    """What does not change when a probe turns."""
    return HarmonicBasis(library, swept_probe(path, fingerprint), SphereView(size))
