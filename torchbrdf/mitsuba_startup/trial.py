"""Whether Mitsuba works here, found out in a process of its own, because an unsuitable LLVM aborts the process."""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

from torchbrdf.mitsuba_startup.loading import (
    LLVM_VARIABLE,
    MitsubaUnavailableError,
    import_mitsuba,
    llvm_problem,
    load_mitsuba,
)

DRJIT_CACHE_VARIABLE = "DRJIT_CACHE_DIR"
TIMEOUT = 120.0
"""Seconds for one render with all imports; it takes about two."""
MARK = "torchbrdf-check "
ALBEDO = 0.5
SIZE = 4
_CHILD = f"import json, sys; sys.path[:] = json.loads(sys.argv[1]); from {__name__} import main; main(sys.argv[2])"


@dataclass(frozen=True)
class Trial:
    """How a process of its own fared that loads Mitsuba and renders.

    facts    what it reported: variants, llvm_version, llvm_path, llvm_problem, threads, then variant and mean
    failure  how it ended; None where it rendered what it should
    reason   what it said about that, in one line
    """

    facts: dict
    failure: str | None = None
    reason: str = ""

    def __str__(self) -> str:
        """One line."""
        if self.failure is None:
            return "a small render came out right"
        return f"{self.failure}: {self.reason}" if self.reason else self.failure


def try_render(variant: str) -> Trial:
    """A small render in a process of its own, with an empty kernel cache, so that the LLVM must compile.

    variant  used whether it is safe or not; "": the one that load_mitsuba chooses
    """
    with tempfile.TemporaryDirectory(prefix="torchbrdf-doctor-") as empty:
        try:
            done = subprocess.run(
                [sys.executable, "-c", _CHILD, json.dumps(sys.path), variant],
                env={**os.environ, DRJIT_CACHE_VARIABLE: empty},
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=TIMEOUT,
            )
        except subprocess.TimeoutExpired as error:
            return Trial(_facts(error.stdout), f"did not end within {TIMEOUT:g} s and was stopped")
    facts, reason = _facts(done.stdout), _reason(done.stderr)
    if done.returncode < 0:
        number = -done.returncode
        return Trial(facts, f"{'aborted' if number == signal.SIGABRT else 'crashed'} (signal {number})", reason)
    if done.returncode > 0:
        return Trial(facts, "failed", facts.get("unavailable", reason))
    if not abs(facts.get("mean", 0) - ALBEDO) < 0.1:
        return Trial(facts, "renders wrong values", f"{facts.get('mean')} where {ALBEDO} is right")
    return Trial(facts)


def main(variant: str) -> None:
    """In that process: report what was loaded, then the mean of a small render, each a line of `MARK` and JSON.

    variant  used whether it is safe or not; "": the one that load_mitsuba chooses
    """
    _no_core_file()
    try:
        _load_and_render(variant)
    except MitsubaUnavailableError as error:
        _report(unavailable=str(error))
        sys.exit(1)


def _facts(output: bytes | None) -> dict:
    facts: dict = {}
    for line in (output or b"").decode(errors="replace").splitlines():
        if line.startswith(MARK):
            facts.update(json.loads(line.removeprefix(MARK)))
    return facts


def _reason(output: bytes) -> str:
    """The line of stderr that says why: the one that LLVM or Dr.Jit gives for it, else the last."""
    lines = [line.strip() for line in output.decode(errors="replace").splitlines() if line.strip()]
    marked = [line for line in lines if line.startswith(("LLVM ERROR", "jit_find_library()", "jit_llvm_init()"))]
    line = (marked or lines[-1:] or [""])[0]
    return line if len(line) <= 300 else line[:300] + " ..."


def _load_and_render(variant: str) -> None:
    mi = import_mitsuba()
    import drjit

    _report(
        variants=mi.variants(),
        llvm_version=list(drjit.detail.llvm_version()),
        llvm_path=_loaded_llvm(),
        llvm_problem=llvm_problem(),
        threads=drjit.thread_count(),
    )
    if variant:
        mi.set_variant(variant)
    else:
        warnings.simplefilter("ignore", UserWarning)
        mi = load_mitsuba()
    _report(variant=mi.variant(), mean=_render())


def _render() -> float:
    """The mean over the image of a sphere that fills it, under a constant light of radiance 1: ALBEDO."""
    import mitsuba as mi
    import numpy as np

    camera = mi.ScalarTransform4f().look_at(origin=[0, 0, 4], target=[0, 0, 0], up=[0, 1, 0])
    scene = {
        "type": "scene",
        "integrator": {"type": "direct"},
        "light": {"type": "constant"},
        "sphere": {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": ALBEDO}}},
        "camera": {
            "type": "perspective",
            "fov": 15,
            "to_world": camera,
            "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}},
        },
    }
    return float(np.array(mi.render(mi.load_dict(scene), spp=64)).mean())


def _loaded_llvm() -> str | None:
    """Path of the libLLVM in this process; where the system does not tell, the one that was named."""
    try:
        maps = Path("/proc/self/maps").read_text(errors="replace")
    except OSError:
        return os.environ.get(LLVM_VARIABLE)
    found = re.search(r"(/\S.*/libLLVM[^/\n]*)$", maps, re.MULTILINE)
    return found.group(1) if found else None


def _no_core_file() -> None:
    """An abort that is expected leaves no core file behind."""
    try:
        import resource
    except ImportError:
        return
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _report(**facts: object) -> None:
    print(MARK + json.dumps(facts), flush=True)
