"""A process with the time that a person waits for it and the memory that it takes."""

import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

_LOOKS = 0.02
"""Seconds between two looks at the memory of a process."""

_SAID = 2000
"""Characters of what a process that failed has said."""


@dataclass(frozen=True)
class Finished:
    """A process that came to its end.

    seconds  by the clock
    peak     MiB, largest resident memory, with its children's; 0 where there is no /proc
    mapped   MiB of it that are pages of files, caches and program code, which the system can take back
    """

    seconds: float
    peak: float
    mapped: float


def finished(command: Sequence[str], environment: Mapping[str, str], folder: Path) -> Finished:
    """Run a command in a folder. Raises RuntimeError with the end of what it said where its exit status is not 0."""
    with tempfile.TemporaryFile() as said:
        started = time.perf_counter()
        process = subprocess.Popen(
            command, cwd=folder, env=dict(environment), stdin=subprocess.DEVNULL, stdout=said, stderr=said
        )
        memory = _Memory(process.pid)
        try:
            process.wait()
            seconds = time.perf_counter() - started
        finally:
            memory.ended.set()
            process.kill()
            process.wait()
        memory.join()
        if process.returncode:
            said.seek(0)
            text = said.read().decode(errors="replace").strip()[-_SAID:]
            raise RuntimeError(f"{' '.join(command)}: exit status {process.returncode}\n{text}")
    return Finished(seconds, memory.peak, memory.mapped)


class _Memory(threading.Thread):
    """Looks at the memory of a process until it ends: what `wait4` tells begins with that of its parent."""

    def __init__(self, pid: int) -> None:
        super().__init__(daemon=True)
        self.pid, self.peak, self.mapped, self.ended = pid, 0.0, 0.0, threading.Event()
        self.start()

    def run(self) -> None:
        """Keep the largest."""
        while not self.ended.wait(_LOOKS):
            own, mapped = resident(self.pid)
            if own + mapped > self.peak:
                self.peak, self.mapped = own + mapped, mapped


def resident(pid: int) -> tuple[float, float]:
    """MiB of a process and its children: own pages, and pages of files, which they share; 0 for one that ended."""
    own = mapped = 0.0
    with suppress(OSError, ValueError, KeyError):
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
        sizes = {key: value for key, _, value in (line.partition(":") for line in lines)}
        own, *files = (int(sizes[key].split()[0]) / 2**10 for key in ("RssAnon", "RssFile", "RssShmem"))
        mapped = sum(files)
        for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
            more, shared = resident(int(child))
            own, mapped = own + more, max(mapped, shared)
    return own, mapped
