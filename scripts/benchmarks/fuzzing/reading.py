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

CONSTANT = 192 << 20
"""Bytes that reading may ask for beside `TIMES_FILE` times the file, where a reader names no other number."""

TIMES_FILE = 4

_SLOW = 0.25
_M_ARENA_MAX = -8
_FORGET_MOST_RESIDENT = "5"
_KEYS = (b"VmRSS:", b"VmHWM:", b"VmSize:", b"VmPeak:")


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
    memory    bytes that it needed at once, less TIMES_FILE times the file
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


def read(
    opened: Callable[[Path], object], path: Path, constant: int = CONSTANT, begun: Callable[[], None] = lambda: None
) -> Reading:
    """Read a file; a second time where the first took long or much, for which what it loaded and keeps may be why.

    constant  bytes that it may ask for beside TIMES_FILE times the file
    begun     is called whenever reading begins
    """
    allowed = TIMES_FILE * path.stat().st_size
    last = first = _attempt(opened, path, begun)
    memory = max(first.touched, first.asked)
    if first.seconds > _SLOW or memory > allowed + constant:
        last = _attempt(opened, path, begun)
        memory = last.touched + max(first.asked - first.touched - first.kept, 0)
    problem = last.problem or first.problem
    if problem is None and memory > allowed + constant:
        message = f"{memory - allowed >> 20} MiB beyond {TIMES_FILE} times the file's {path.stat().st_size} bytes"
        problem = Problem("memory", "", message)
    return Reading(last.accepted, last.seconds, memory - allowed, problem)


@dataclass(frozen=True)
class _Attempt:
    """One of the two: bytes touched at once, asked for at once (0 where earlier ones asked for more), and kept."""

    accepted: bool
    problem: Problem | None
    seconds: float
    touched: int
    asked: int
    kept: int


def _attempt(opened: Callable[[Path], object], path: Path, begun: Callable[[], None]) -> _Attempt:
    # It forgets the peak of what is resident, and cannot be made to forget that of what is asked for.
    Path("/proc/self/clear_refs").write_text(_FORGET_MOST_RESIDENT)
    resident, _, size, most = _memory()
    accepted, problem = False, None
    begun()
    start = time.perf_counter()
    try:
        opened(path)
        accepted = True
    except (OSError, ValueError) as error:
        problem = _unclear(error, path)
    except BaseException as error:  # an extension's panic is no Exception
        problem = Problem("exception", _place(error), f"{type(error).__name__}: {error}"[:300])
    seconds = time.perf_counter() - start
    _, most_resident, size_after, most_after = _memory()
    asked = most_after - size if most_after > most else 0
    return _Attempt(accepted, problem, seconds, most_resident - resident, asked, size_after - size)


def _memory() -> list[int]:
    """Bytes of this process: resident, most resident, address space, most address space."""
    with open("/proc/self/status", "rb") as file:
        held = file.read()
    return [int(held[held.index(name) :].split(maxsplit=2)[1]) << 10 for name in _KEYS]


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
