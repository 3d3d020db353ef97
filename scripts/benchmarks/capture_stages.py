"""The ways from files of a camera to a table that scripts/benchmarks/capture.py measures, and the commands of each."""

import hashlib
import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch

import torchbrdf as tb
from torchbrdf.experiments import Target
from torchbrdf.images import relative_rms
from torchbrdf.rendering import render_tables

PROGRAM = (sys.executable, "-m", "torchbrdf.cli")
PATIENCE = 900
"""Seconds after which a command is taken for hung."""

Command = list[str]


@dataclass(frozen=True)
class Capture:
    """A folder of scripts/make_captures.py, and where results go.

    by_hand  circles are taken from the truth and given to the commands, which find them otherwise
    options  of `fit`, such as a library
    """

    folder: Path
    truth: Mapping[str, Any]
    work: Path
    by_hand: bool = False
    options: tuple[str, ...] = ()

    @classmethod
    def open(cls, folder: Path, work: Path, by_hand: bool = False, options: Sequence[str] = ()) -> "Capture":
        """Read the truth."""
        return cls(folder, json.loads((folder / "truth.json").read_text()), work, by_hand, tuple(options))

    @property
    def fov(self) -> Command:
        """What is known of the camera."""
        return ["--fov", f"{self.truth['fov_deg']:g}"]

    def circle(self, ball: str, option: str = "--circle") -> Command:
        """Where a ball is, where that is given by hand."""
        return [option, *(f"{number:.3f}" for number in self.truth[ball]["circle"])] if self.by_hand else []

    def brackets(self, ball: str) -> list[str]:
        """The files of a series."""
        return [str(self.folder / one["file"]) for one in self.truth[f"{ball}_brackets"]]

    def fit(self, photo: Path, probe: Path, *more: str) -> Command:
        """`torchbrdf fit` of a whole photograph."""
        about = [*self.fov, *self.circle("ball"), *more, *self.options]
        return ["fit", str(photo), "--probe", str(probe), *about, "-o", str(self.work)]

    def probe(self, photo: Path, ball: str) -> Command:
        """`torchbrdf probe` of a mirror ball, to probe.exr."""
        about = [*self.fov, *self.circle(ball), "--mirror-reflectance", f"{self.truth[ball]['reflectance']:g}"]
        return ["probe", str(photo), *about, "-o", str(self.work / "probe.exr")]


@dataclass(frozen=True)
class Stage:
    """One way from files to a table.

    needs     what the commands need: a command, or "COMMAND --OPTION"
    commands  in order; the last one is `fit`
    """

    name: str
    needs: tuple[str, ...]
    commands: Callable[[Capture], list[Command]]


def _ideal(capture: Capture) -> list[Command]:
    files = [str(capture.folder / "ideal.exr"), "--probe", str(capture.folder / "probe.exr")]
    return [["fit", *files, *capture.options, "-o", str(capture.work)]]


def _with(probe: str, *more: str) -> Callable[[Capture], list[Command]]:
    return lambda capture: [capture.fit(capture.folder / "photo.exr", capture.folder / probe, *more)]


def _mirror(ball: str) -> Callable[[Capture], list[Command]]:
    def commands(capture: Capture) -> list[Command]:
        made = capture.probe(capture.folder / f"{ball}.exr", ball)
        return [made, capture.fit(capture.folder / "photo.exr", capture.work / "probe.exr")]

    return commands


def _mirror_read_by_fit(capture: Capture) -> list[Command]:
    by_hand = replace(capture, by_hand=True)
    layout = ["--probe-layout", "mirror_ball", *by_hand.circle("chrome", "--probe-circle"), "--repair-probe"]
    return [by_hand.fit(capture.folder / "photo.exr", capture.folder / "chrome.exr", *layout)]


def _brackets(capture: Capture) -> list[Command]:
    photo, chrome = capture.work / "photo.exr", capture.work / "chrome.exr"
    return [
        ["merge", *capture.brackets("chrome"), "-o", str(chrome)],
        ["merge", *capture.brackets("photo"), "--like", str(chrome), "-o", str(photo)],
        capture.probe(chrome, "chrome"),
        capture.fit(photo, capture.work / "probe.exr"),
    ]


FINDING = "fit --ball"
"""What a `fit` that finds the ball in a whole photograph has."""

IDEAL = "ideal observation, true probe"
STAGES = (
    Stage(IDEAL, (), _ideal),
    Stage("photograph, true probe", (FINDING,), _with("probe.exr")),
    Stage("probe turned by 2 degrees, --align", (FINDING,), _with("probe_turned.exr", "--align")),
    Stage("mirror ball", (FINDING, "probe"), _mirror("chrome")),
    Stage("mirror ball of 60 % elsewhere", (FINDING, "probe"), _mirror("chrome60")),
    Stage("8-bit brackets of both", (FINDING, "probe", "merge"), _brackets),
    Stage("clipped lamps, --align", (FINDING,), _with("probe_clipped.exr", "--align")),
    Stage("clipped lamps as they are", (FINDING,), _with("probe_clipped.exr")),
)
BY_HAND = Stage("mirror ball by hand, --probe-circle", (), _mirror_read_by_fit)
"""As before there was `torchbrdf probe`; only among what is done by hand."""


def stages(by_hand: bool) -> list[Stage]:
    """Those to run: with circles given by hand nothing needs to be found."""
    if not by_hand:
        return list(STAGES)
    given = [replace(stage, needs=tuple(need for need in stage.needs if need != FINDING)) for stage in STAGES]
    return [*given, BY_HAND]


@lru_cache
def is_available(need: str) -> bool:
    """Whether the program has a command, or a command an option."""
    command, _, option = need.partition(" ")
    told = subprocess.run([*PROGRAM, command, "--help"], capture_output=True, text=True, check=False)
    return told.returncode == 0 and option in told.stdout


def code_of_package() -> str:
    """A hash of the program: results of another are not its results."""
    total = hashlib.sha256()
    for path in sorted(Path(str(tb.__file__)).parent.rglob("*.py")):
        total.update(path.read_bytes())
    return total.hexdigest()


@dataclass(frozen=True)
class Ran:
    """What commands, one after the other until one fails, said.

    message  of the failure; None where all succeeded
    """

    seconds: float
    warnings: list[str]
    message: str | None


def run_commands(commands: Sequence[Command]) -> Ran:
    """Run commands of the program as processes."""
    warned: list[str] = []
    started = time.perf_counter()

    def ran(message: str | None) -> Ran:
        return Ran(time.perf_counter() - started, warned, message)

    for command in commands:
        try:
            done = subprocess.run([*PROGRAM, *command], capture_output=True, text=True, timeout=PATIENCE, check=False)
        except subprocess.TimeoutExpired:
            return ran(f"{command[0]}: not finished after {PATIENCE} s")
        lines = done.stderr.replace("\r", "\n").splitlines()
        warned += [line.partition("warning: ")[2] for line in lines if "warning: " in line]
        if done.returncode != 0:
            said = [line for line in lines if line.strip()]
            return ran(f"{command[0]}: {said[-1] if said else f'exit status {done.returncode}'}")
    return ran(None)


def novel_error(table: tb.MerlTable, lights: Mapping[str, tb.LightProbe], targets: Mapping[str, Target]) -> float:
    """The mean over the lights of |rendered - target| / |target|."""
    errors = []
    for name, light in lights.items():
        target = targets[name]
        view = tb.SphereView(target.size)
        shown = render_tables([table], light, view, seed=3000)[0]
        errors.append(relative_rms(shown.double(), target.photograph.double(), view.mask))
    return sum(errors) / len(errors)


@lru_cache
def light_at(path: Path) -> tb.LightProbe:
    """A light under which results are shown, opened once a process."""
    return tb.LightProbe.open(path)


def capture_case(
    stage: str, by_hand: bool, options: Sequence[str], code: str, truth: Mapping[str, Any], captures: str
) -> dict[str, Any]:
    """Run a stage on a capture and score its table under all lights but its own.

    code      see `code_of_package`
    truth     of the capture; captures: the folder that holds it, beside `lights` and `targets`
    returns   error (None where a command failed), seconds, warnings, message
    """
    root = Path(captures)
    if code != code_of_package():
        raise ValueError("the package changed while the benchmark ran; start it again with another output folder")
    with TemporaryDirectory() as work:
        folder = root / truth["plan"]["name"]
        capture = Capture.open(folder, Path(work) / "out", by_hand, options)
        capture.work.mkdir()
        chosen = next(one for one in stages(by_hand) if one.name == stage)
        ran = run_commands(chosen.commands(capture))
        error = None
        if ran.message is None:
            names = [path.stem for path in sorted((root / "lights").glob("*.exr")) if path.stem != truth["probe"]]
            lights = {name: light_at(root / "lights" / f"{name}.exr") for name in names}
            targets = {name: Target.open(root / "targets" / name / f"{truth['material']}.exr") for name in names}
            with torch.no_grad():
                error = novel_error(tb.MerlTable.open(capture.work / "brdf.binary"), lights, targets)
    return {"error": error, "seconds": ran.seconds, "warnings": ran.warnings, "message": ran.message}
