"""The process that watches: starts workers, ends those that hang or swell, and counts what comes of every reader."""

import multiprocessing
import os
import re
import signal
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from multiprocessing import connection, forkserver
from pathlib import Path
from typing import Any

from fuzzing.reading import Problem, place
from fuzzing.worker import TRACE, Progress, Share, work

PATIENCE = 5.0
"""Seconds after which reading a small file is a hang."""

_POLL = 0.05
_MOST_RESIDENT = 3 << 30
"""Bytes of a worker at which it is ended, before the machine suffers."""

_PRELOADED = (
    "torch",
    "safetensors.torch",
    "cv2",
    "OpenEXR",
    "PIL.Image",
    "tifffile",
    "imagecodecs",
    "trimesh",
    "scipy.spatial",
    "scipy.sparse.csgraph",
    "tqdm",
    "torchbrdf.images.pictures",
    "torchbrdf.images.masks",
    "torchbrdf.light.probe",
    "torchbrdf.view.normal_map",
    "torchbrdf.brdf.merl",
    "torchbrdf.transport.basis_images",
    "fuzzing.worker",
)
"""What workers would else import one by one."""

_CONTEXT = multiprocessing.get_context("forkserver")  # a worker that ended is replaced at once


@dataclass(frozen=True)
class Finding:
    """A problem, and the input that has it."""

    share: Share
    index: int
    problem: Problem

    @property
    def signature(self) -> tuple[str, str, str]:
        """Equal for findings that are probably one fault."""
        return self.share.reader, self.problem.kind, self.problem.where


@dataclass
class Tally:
    """Sums over a reader's inputs: counts, seconds of all and of the slowest, bytes beyond four times the file."""

    inputs: int = 0
    accepted: int = 0
    seconds: float = 0.0
    slowest: float = 0.0
    memory: int = 0
    findings: list[Finding] = field(default_factory=list)

    def add(self, progress: Progress) -> None:
        """Count what a worker did."""
        self.inputs += progress.done
        self.accepted += progress.accepted
        self.seconds += progress.seconds
        self.slowest = max(self.slowest, progress.slowest)
        self.memory = max(self.memory, progress.memory)


def run(
    shares: Sequence[Share],
    tallies: dict[str, Tally],
    processes: int = 1,
    patience: float = PATIENCE,
    advanced: Callable[[int], None] = lambda count: None,
) -> None:
    """Read all inputs of all shares, and count in `tallies` by reader, also what was done when it is interrupted.

    advanced  is told how many inputs more were read
    """
    _start_server()
    waiting, running = deque(shares), list[_Run]()
    try:
        while waiting or running:
            while waiting and len(running) < processes:
                running.append(_Run(waiting.popleft(), patience))
            connection.wait([one.process.sentinel for one in running], _POLL)
            for one in running:
                one.watch(tallies[one.share.reader])
                advanced(one.news())
            running = [one for one in running if not one.finished]
    finally:
        for one in running:
            one.close(tallies[one.share.reader])


def _start_server() -> None:
    """The process that forks workers, which finds modules where this one does: not first in the current folder."""
    _CONTEXT.set_forkserver_preload(list(_PRELOADED))
    places = {"PYTHONSAFEPATH": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    before = {name: os.environ.get(name) for name in places}
    os.environ.update(places)
    try:
        forkserver.ensure_running()
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


class _Run:
    """A share, and the workers that read it one after another."""

    def __init__(self, share: Share, patience: float) -> None:
        self.share, self.patience = share, patience
        self.progress: Any = _CONTEXT.Value(Progress, lock=False)
        self.finished = False
        self.suspected: int | None = None
        self.seen = 0
        self.folder = tempfile.TemporaryDirectory(prefix="fuzz-")
        self._start(share.first)

    def _start(self, first: int) -> None:
        self.progress.index, self.progress.started = first, 0.0
        self.receiver, sender = _CONTEXT.Pipe(duplex=False)
        arguments = (self.share, first, self.progress, sender, self.folder.name)
        self.process = _CONTEXT.Process(target=work, args=arguments, daemon=True)
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # Ctrl-C is for the watcher alone
        try:
            self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        sender.close()

    def watch(self, tally: Tally) -> None:
        """Take what was found, and end or replace the worker where it is time."""
        self._receive(tally)
        started, index = self.progress.started, self.progress.index
        if not self.process.is_alive():
            self._receive(tally)
            self._ended(tally)
        elif started and time.monotonic() - started > self.patience:
            where = self._stop()
            if self.suspected == index:
                self._lose(tally, Problem("hang", where, f"more than {self.patience:g} s, twice"))
            else:  # perhaps the machine had other things to do
                self.suspected = index
                self._start(index)
        elif (resident := self._resident()) > _MOST_RESIDENT:
            self._lose(tally, Problem("memory", self._stop(), f"ended at {resident >> 20} MiB of resident memory"))

    def news(self) -> int:
        """Inputs read since the last call."""
        news = self.progress.done - self.seen
        self.seen = self.progress.done
        return news

    def close(self, tally: Tally) -> None:
        """End the worker, and count what it did."""
        if self.process.is_alive():
            self.process.kill()
        self.process.join()
        self.receiver.close()
        tally.add(self.progress)
        self.folder.cleanup()
        self.finished = True

    def _ended(self, tally: Tally) -> None:
        status = self.process.exitcode or 0
        if status == 0 and self.progress.index >= self.share.end:
            self.close(tally)
        elif self.progress.started:
            name = signal.Signals(-status).name if status < 0 else f"exit status {status}"
            self._lose(tally, Problem("crash", self._place(), name))
        elif status == 0:
            self._start(self.progress.index + 1)
        else:
            raise ChildProcessError(
                f"a worker ended with status {status} before it read input {self.progress.index} of {self.share.reader}"
            )

    def _lose(self, tally: Tally, problem: Problem) -> None:
        """Count an input that took its worker along, and go on behind it."""
        tally.findings.append(Finding(self.share, self.progress.index, problem))
        self.progress.done += 1
        self._start(self.progress.index + 1)

    def _receive(self, tally: Tally) -> None:
        try:
            while self.receiver.poll():
                tally.findings.append(Finding(self.share, *self.receiver.recv()))
        except (EOFError, OSError):
            pass  # the worker is gone

    def _stop(self) -> str:
        """End the worker; returns where it was."""
        os.kill(self.process.pid or 0, signal.SIGUSR1)
        time.sleep(0.2)
        self.process.kill()
        self.process.join()
        return self._place()

    def _place(self) -> str:
        trace = Path(self.folder.name, TRACE).read_text(errors="replace")
        first = trace.partition("Current thread")[2].partition("\n\n")[0]
        return place([(name, int(line)) for name, line in re.findall(r'File "(.*)", line (\d+) in', first)])

    def _resident(self) -> int:
        try:
            pages = Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]
        except (OSError, IndexError):
            return 0  # it ended just now
        return int(pages) * os.sysconf("SC_PAGE_SIZE")
