"""One file, one reader: what came of it, in how much time and address space."""

import ctypes
import logging
import os
import resource
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch

CONSTANT = 64 << 20
"""Bytes that reading may ask for beside `TIMES_FILE` times the file."""

TIMES_FILE = 4

_SLOW = 0.25
_M_ARENA_MAX = -8
_STATUS = "/proc/self/status"


@dataclass(frozen=True)
class Problem:
    """What a reader must not do.

    kind     "crash", "hang", "memory", "exception", or "message": an error that names no file or is not one line
    where    the last place in the package that it came through
    message  what was said
    """

    kind: str
    where: str
    message: str


@dataclass(frozen=True)
class Reading:
    """What came of reading a file.

    accepted  whether there was no error
    seconds   by the clock
    memory    bytes of address space asked for at once, less TIMES_FILE times the file; 0 where it is not more than
              earlier readings of this process asked for
    problem   None where all is as it should be
    """

    accepted: bool
    seconds: float
    memory: int
    problem: Problem | None


def prepare_process() -> None:
    """One thread, one arena, no core files, nothing printed: what is measured is the reader."""
    torch.set_num_threads(1)
    if sys.platform == "linux":
        ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter("ignore")
    logging.disable()
    sink = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(sink, stream)


def read(opened: Callable[[Path], object], path: Path) -> Reading:
    """Read a file; a second time where the first took long or much, for which modules that it loaded may be why."""
    reading = _read(opened, path, only_growth=True)
    if reading.seconds > _SLOW or reading.memory > CONSTANT:
        reading = _read(opened, path, only_growth=False)
    if reading.problem is None and reading.memory > CONSTANT:
        message = f"{reading.memory >> 20} MiB beyond {TIMES_FILE} times the file's {path.stat().st_size} bytes"
        return Reading(reading.accepted, reading.seconds, reading.memory, Problem("memory", "", message))
    return reading


def _read(opened: Callable[[Path], object], path: Path, only_growth: bool) -> Reading:
    before, peak_before = _address_space()
    accepted, problem = False, None
    start = time.perf_counter()
    try:
        opened(path)
        accepted = True
    except (OSError, ValueError) as error:
        problem = _unclear(error, path)
    except BaseException as error:  # an extension's panic is no Exception
        problem = Problem("exception", _place(error), f"{type(error).__name__}: {error}"[:300])
    seconds = time.perf_counter() - start
    _, peak = _address_space()
    grown = peak > peak_before or not only_growth
    return Reading(accepted, seconds, peak - before - TIMES_FILE * path.stat().st_size if grown else 0, problem)


def _unclear(error: OSError | ValueError, path: Path) -> Problem | None:
    """What is wrong with the message of an error, as the command line prints it."""
    filename = getattr(error, "filename", None)
    message = f"{filename}: {error.strerror}" if isinstance(error, OSError) and filename else str(error)
    if path.name not in message:
        return Problem("message", _place(error), f"names no file: {message[:300]!r}")
    if not message.isprintable():
        return Problem("message", _place(error), f"not one line of printable text: {message[:300]!r}")
    return None


def _place(error: BaseException) -> str:
    frames = [(frame.filename, frame.lineno or 0) for frame in traceback.extract_tb(error.__traceback__)]
    return place(frames[::-1])


def place(frames: list[tuple[str, int]]) -> str:
    """Where a traceback, innermost frame first, last came through the package, and where it ends."""
    named = [f"{'/'.join(Path(name).parts[-3:])}:{line}" for name, line in frames]
    within = next((text for text in named if "torchbrdf/" in text), None)
    return " in ".join(dict.fromkeys([*named[:1], *([within] if within else [])]))


def _address_space() -> tuple[int, int]:
    """Bytes now, and at most so far."""
    with open(_STATUS, "rb") as file:
        peak, now = (int(line.split()[1]) << 10 for line in file.read().splitlines() if line.startswith((b"VmPeak", b"VmSize")))
    return now, peak
