"""`torchbrdf doctor`: what is installed here, what works, and what to do about what does not."""

import argparse
import importlib
import importlib.metadata
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import fill

from torchbrdf._version import __version__
from torchbrdf.commands._findings import Findings
from torchbrdf.files import cache_folder
from torchbrdf.mitsuba_startup import (
    DRJIT_CACHE_VARIABLE,
    FAST_VARIANT,
    LLVM_PACKAGE,
    LLVM_VARIABLE,
    OLDEST_LLVM,
    SLOW_VARIANT,
    Trial,
    mitsuba_program,
    packaged_llvm,
    try_render,
)

PACKAGES = {
    "torch": "torch",
    "numpy": "numpy",
    "scipy": "scipy",
    "OpenEXR": "OpenEXR",
    "opencv-python-headless": "cv2",
    "safetensors": "safetensors",
    "trimesh": "trimesh",
    "mapbox-earcut": "mapbox_earcut",
}
"""Packages that torchbrdf needs, and the module of each."""
OTHER_OPENCV = ("opencv-python", "opencv-contrib-python-headless", "opencv-contrib-python")
WIDEST = 110
"""Characters in a line, at most."""
SPARE_BYTES = 1_700_000_000
"""The embedded library takes 1 GB in the cache, and its transport the rest."""
WHATEVER_FAILS = (
    ArithmeticError, AttributeError, ImportError, LookupError, OSError, RuntimeError, TypeError, ValueError, Warning,
    subprocess.SubprocessError,
)  # fmt: skip
_REINSTALL = f"run `pip install --force-reinstall mitsuba drjit {LLVM_PACKAGE}`"
_SLOW = f'and until that helps mitsuba.set_variant("{SLOW_VARIANT}") before you use torchbrdf'


@dataclass
class Section:
    """One heading of the report: lines of a label and a text, and the problems found, each with what to do."""

    title: str
    lines: list[tuple[str, str]] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    def add(self, label: str, text: str) -> None:
        """One line."""
        self.lines.append((label, text))

EXAMPLES = (
    "torchbrdf doctor",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """None."""


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Say what is installed, what works here, and what to do about each problem.

    Nothing is changed, and what may crash runs in a process of its own. Exit status: 0 without problems, 1 with some.
    """
    problems: list[str] = []
    told: dict[str, list[dict[str, str]]] = {}
    trial: list[Trial] = []
    parts: list[tuple[str, Callable[[Section], None]]] = [
        ("Versions", _versions),
        ("Mitsuba", lambda section: trial.append(_mitsuba(section))),
        ("Threads", lambda section: _threads(section, trial[0].facts if trial else {})),
        ("CUDA", _cuda),
        ("Caches", _caches),
    ]
    for title, fill_in in parts:
        section = Section(title)
        try:
            fill_in(section)
        except WHATEVER_FAILS as error:
            text = f"{type(error).__name__}: {_one_line(str(error))}"
            section.add("failed", text)
            section.problems.append(f"{title}: {text}; please report this with all lines above")
        _tell(section, findings)
        told[section.title] = [{"label": label, "text": text} for label, text in section.lines]
        problems += section.problems
    findings.line("Problems" if problems else "no problems found")
    for i, problem in enumerate(problems, 1):
        findings.line(_filled(problem, f"  {i}. "))
    findings.add(sections=told, problems=problems)
    if problems:
        findings.failed(f"{len(problems)} problem{'s' * (len(problems) > 1)} found")
    return 1 if problems else 0


def _versions(section: Section) -> None:
    section.add("torchbrdf", __version__)
    section.add("Python", f"{platform.python_version()} ({sys.executable or 'unknown executable'})")
    section.add("system", f"{platform.system()} {platform.release()} {platform.machine()}")
    for package, module in PACKAGES.items():
        name = next((one for one in (package, *OTHER_OPENCV) if _version(one)), package) if module == "cv2" else package
        section.add(name, _version(name) or "not installed")
        try:
            importlib.import_module(module)
        except WHATEVER_FAILS as error:
            reason = _one_line(str(error))
            section.problems.append(f"{name} cannot be imported ({reason}); run `pip install --force-reinstall {name}`")
    for name in ("mitsuba", "drjit", LLVM_PACKAGE):
        section.add(name, _version(name) or "not installed")
    if version := _version("kornia"):
        section.add("kornia", version)


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _mitsuba(section: Section) -> Trial:
    """Try the fast variant, safe or not; where it is of no use, also what load_mitsuba chooses instead."""
    trial = try_render(FAST_VARIANT)
    facts = trial.facts
    if "unavailable" in facts:
        section.add("import", facts["unavailable"])
        section.problems.append(facts["unavailable"])
        return trial
    if not facts:
        section.add("import", str(trial))
        section.problems.append(f"Mitsuba does not load, {trial}; {_REINSTALL}")
        return trial
    section.add("variants", ", ".join(facts["variants"]))
    section.add("LLVM", _llvm(facts))
    section.add(FAST_VARIANT, str(trial))
    problem = facts["llvm_problem"]
    if problem is not None:
        section.problems.append(f"Mitsuba's {FAST_VARIANT} {trial.failure or 'is not used'}: {problem}")
    elif trial.failure is not None:
        section.problems.append(f"Mitsuba's {FAST_VARIANT} {trial}; {_REINSTALL}, {_SLOW}")
    else:
        section.add("used", FAST_VARIANT)
        section.add("its program", mitsuba_program("SCENE.xml"))
        return trial
    used = try_render("" if problem is not None else SLOW_VARIANT)
    section.add("used" if problem is not None else SLOW_VARIANT, f"{used.facts.get('variant', 'none')} (slow): {used}")
    if used.failure is not None:
        section.problems.append(f"Mitsuba's {SLOW_VARIANT} {used}; {_REINSTALL}")
    return used


def _llvm(facts: dict) -> str:
    version, path = facts["llvm_version"], facts["llvm_path"]
    text = ".".join(map(str, version)) if version[0] > 0 else f"none that Dr.Jit takes ({OLDEST_LLVM} or newer needed)"
    packaged, named = packaged_llvm(), os.environ.get(LLVM_VARIABLE)
    if packaged is not None and path and Path(path).resolve() == packaged:
        origin = f"from the package {LLVM_PACKAGE}"
    elif named:
        origin = f"named by {LLVM_VARIABLE}={named}"
    else:
        origin = f"looked for on the system; {LLVM_VARIABLE} is not set, {LLVM_PACKAGE} is not installed"
    return f"{text}, {path}, {origin}" if path else f"{text}, {origin}"


def _threads(section: Section, facts: dict) -> None:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    import torch

    threads = torch.get_num_threads()
    section.add("CPU cores", f"{cores} usable")
    section.add("torch", f"{threads} threads")
    section.add("OMP_NUM_THREADS", os.environ.get("OMP_NUM_THREADS", "not set"))
    section.add("OMP_WAIT_POLICY", os.environ.get("OMP_WAIT_POLICY", "not set"))
    section.add("GOMP_SPINCOUNT", os.environ.get("GOMP_SPINCOUNT", "not set"))
    section.add("Dr.Jit", f"{facts['threads']} threads" if "threads" in facts else "unknown, Mitsuba does not load")


def _cuda(section: Section) -> None:
    import torch

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        available = torch.cuda.is_available()
    if available:
        for i in range(torch.cuda.device_count()):
            section.add(f"device {i}", torch.cuda.get_device_name(i))
    else:
        section.add("torch", "not available, not needed")
    for warning in caught:
        section.add("warning", _one_line(str(warning.message)))


def _caches(section: Section) -> None:
    cure = "set TORCHBRDF_CACHE to a folder that you can write"
    try:
        folder = cache_folder().absolute()
    except RuntimeError as error:
        folder = Path.cwd()
        section.add("torchbrdf", f"unknown ({error})")
        section.problems.append(f"torchbrdf's cache folder is unknown ({error}); {cure}")
    else:
        _folder(section, "torchbrdf", folder, cure)
    chosen, home = os.environ.get(DRJIT_CACHE_VARIABLE), os.environ.get("HOME")
    cure = f"set {DRJIT_CACHE_VARIABLE} to a folder that you can write, else Mitsuba compiles anew in each process"
    if chosen or home:
        _folder(section, "Dr.Jit", Path(chosen or f"{home}/.drjit").absolute(), cure)
    elif os.name == "posix":
        section.add("Dr.Jit", "none: HOME is not set")
        section.problems.append(f"Dr.Jit keeps no kernels, because HOME is not set; {cure}")
    anchor = _existing(folder)
    free = shutil.disk_usage(anchor).free
    section.add("free disk space", f"{_size(free)} at {anchor}")
    if free < SPARE_BYTES:
        section.problems.append(
            f"only {_size(free)} free at {anchor}, and the embedded library and its transport take 1.7 GB there; "
            "delete something, or set TORCHBRDF_CACHE to a folder on another disk"
        )


def _folder(section: Section, label: str, folder: Path, cure: str) -> None:
    """A line on a cache folder: its size and whether a file can be made in it; a problem where not."""
    try:
        if os.path.lexists(folder):
            size = _size(sum(_sizes(folder)))
            with tempfile.TemporaryFile(dir=folder):
                section.add(label, f"{folder}: {size}, writable")
        elif os.access(anchor := _existing(folder), os.W_OK | os.X_OK):
            section.add(label, f"{folder}: not there yet, can be made")
        else:
            raise PermissionError(f"{anchor} cannot be written")
    except OSError as error:
        reason = error.strerror or str(error)
        section.add(label, f"{folder}: cannot be used ({reason})")
        section.problems.append(f"{label}'s cache folder {folder} cannot be used ({reason}); {cure}")


def _sizes(folder: Path) -> Iterable[int]:
    for here, _, files in os.walk(folder):
        for name in files:
            try:
                yield os.lstat(os.path.join(here, name)).st_size
            except OSError:  # another process tidies up meanwhile, or it may not be seen
                continue


def _existing(folder: Path) -> Path:
    """The folder or the nearest above it that exists."""
    return next(one for one in (folder, *folder.parents) if os.path.isdir(one))


def _size(size: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.4g} TB"


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _tell(section: Section, findings: Findings) -> None:
    findings.line(section.title)
    width = max((len(label) for label, _ in section.lines), default=0) + 4
    for label, text in section.lines:
        findings.line(_filled(text, f"  {label}".ljust(width)))
    findings.line("", at_once=True)


def _filled(text: str, start: str) -> str:
    """The text as lines that fit the terminal, the first after `start`, the others below it."""
    width = min(max(shutil.get_terminal_size((100, 24)).columns, len(start) + 40), WIDEST)
    below = " " * len(start)
    return fill(text, width, initial_indent=start, subsequent_indent=below, break_long_words=False,
                break_on_hyphens=False)  # fmt: skip
