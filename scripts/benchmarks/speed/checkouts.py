"""The version that is measured and its rival: who imports them, and the caches that each has for itself."""

import argparse
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from compare_versions import Version
from speed.processes import Finished, finished
from torchbrdf.files import cache_folder

ROOT = Path(__file__).resolve().parents[3]
"""Of this repository."""

_BENCHMARKS = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Checkout:
    """A version of torchbrdf.

    name      as it calls itself
    revision  of its checkout; "-changed" after it where files differ from that
    cache     its TORCHBRDF_CACHE: no version reads what another has written
    """

    name: str
    revision: str
    version: Version
    cache: Path

    @classmethod
    def of(cls, role: str, argument: str, folder: Path) -> "Checkout":
        """From the root of a checkout, or the python of an environment; its cache will be a folder in `folder`."""
        version = Version.of(role, argument)
        code = "import torchbrdf; print(torchbrdf.__version__); print(torchbrdf.__file__)"
        environment = _environment(version, folder)
        command = [version.python, "-c", code]
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True)
        name, location = done.stdout.split("\n")[:2]
        if version.tree is not None and version.tree not in Path(location).parents:
            raise ValueError(f"{argument}: {location} was imported instead of this checkout")
        revision = name if version.tree is None else _revision(version.tree)
        return cls(name, revision, version, folder / f"{role}-{name}")

    def run(self, arguments: Sequence[str], folder: Path, cache: Path | None = None) -> Finished:
        """Run its python with arguments in a folder; with another cache than its own where one is given."""
        environment = _environment(self.version, cache or self.cache)
        return finished([self.version.python, *arguments], environment, folder)

    def offers(self, command: str, text: str) -> bool:
        """Whether the help of a command holds a text, in small letters."""
        return text in " ".join(_help(self.version, command).lower().split())

    def prepare(self, folder: Path) -> None:
        """Expand the library and precompute its transport where its cache lacks them."""
        self.cache.mkdir(parents=True, exist_ok=True)
        one_camera = ["--orthographic"] if self.offers("precompute", "--orthographic") else []
        self.run(["-m", "torchbrdf.cli", "precompute", *one_camera], folder)

    def expanded(self, folder: Path) -> Path:
        """A new cache in a folder that holds the expanded library and nothing else."""
        shutil.copytree(self.cache / "libraries", folder / "libraries", copy_function=_linked)
        return folder


def _environment(version: Version, cache: Path) -> dict[str, str]:
    """Of the caller, but for Python's settings. The benchmarks come last on the path: children run modules of them."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    places = [*([str(version.tree)] if version.tree else []), str(_BENCHMARKS)]
    return kept | {"PYTHONPATH": os.pathsep.join(places), "TORCHBRDF_CACHE": str(cache)}


@cache
def _help(version: Version, command: str) -> str:
    environment = _environment(version, Path(os.devnull)) | {"COLUMNS": "1000"}
    arguments = [version.python, "-m", "torchbrdf.cli", command, "--help"]
    return subprocess.run(arguments, cwd="/", env=environment, capture_output=True, text=True, check=True).stdout


def _revision(tree: Path) -> str:
    command = ["git", "-C", str(tree), "describe", "--always", "--exclude=*", "--dirty=-changed"]
    done = subprocess.run(command, capture_output=True, text=True)
    return done.stdout.strip() or "unknown"


def _linked(source: str, target: str) -> str:
    """A second name of a file, 1 GB a library; a copy where the disk allows none."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
    return target


def speed_options(parser: argparse.ArgumentParser, rival: bool = True) -> None:
    """What the benchmarks of speed share: the rival, a folder, the page that is written."""
    if rival:
        text = "root of the checkout of another version, or a python that has it"
        parser.add_argument("--rival", required=True, help=text)
    text = "of caches, inputs, references and earlier rows; default: %(default)s"
    parser.add_argument("--folder", type=Path, default=cache_folder() / "benchmarks", help=text)
    parser.add_argument("--document", type=Path, help="page between whose markers the table is put")


def this(options: argparse.Namespace) -> Checkout:
    """This repository, with warm caches, which this process reads from now on, too."""
    options.folder = options.folder.resolve()
    options.folder.mkdir(parents=True, exist_ok=True)
    version = Checkout.of("now", str(ROOT), options.folder)
    version.prepare(options.folder)
    os.environ["TORCHBRDF_CACHE"] = str(version.cache)
    return version


def both(options: argparse.Namespace) -> tuple[Checkout, Checkout]:
    """This repository and the rival, with warm caches."""
    version = this(options)
    rival = Checkout.of("rival", options.rival, options.folder)
    rival.prepare(options.folder)
    return version, rival


def machine() -> str:
    """Cores and their maker, versions of PyTorch and Python."""
    import torch

    models = [line for line in _lines("/proc/cpuinfo") if line.startswith("model name")]
    model = models[0].partition(":")[2].strip() if models else platform.machine()
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{cores} cores ({model}), PyTorch {torch.__version__}, Python {sys.version.split()[0]}"


def _lines(path: str) -> list[str]:
    return Path(path).read_text().splitlines() if Path(path).is_file() else []
