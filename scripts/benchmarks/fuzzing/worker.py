"""The process that reads: one share of a reader's inputs after another, watched by `campaign`."""

import ctypes
import faulthandler
import os
import signal
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from fuzzing.files import InputFile
from fuzzing.readers import Reader
from fuzzing.reading import prepare_process, read

TRACE = "trace"
"""File in a worker's folder that holds where it crashed, or where it was when SIGUSR1 came."""


@dataclass(frozen=True)
class Share:
    """Some of a reader's inputs.

    source  module of the reader's table
    seed    of the mutations; None: the seeds themselves, by every entry
    first   number of the first input
    count   of inputs
    """

    source: str
    reader: str
    seeds: Sequence[InputFile]
    seed: int | None
    first: int
    count: int

    @property
    def end(self) -> int:
        """One past the last input."""
        return self.first + self.count

    def input(self, index: int) -> tuple[InputFile, str]:
        """An input and the entry that opens it."""
        reader = Reader.named(self.source, self.reader)
        if self.seed is not None:
            return reader.input(self.seeds, self.seed, index)
        entries = list(reader.entries)
        return self.seeds[index // len(entries)], entries[index % len(entries)]

    @classmethod
    def of_seeds(cls, source: str, reader: str, seeds: Sequence[InputFile]) -> "Share":
        """Every file as it is, by every entry."""
        return cls(source, reader, seeds, None, 0, len(seeds) * len(Reader.named(source, reader).entries))


class Progress(ctypes.Structure):
    """What a worker lets its watcher see, in shared memory: where it is, and sums over its share so far."""

    _fields_ = (
        ("index", ctypes.c_longlong),
        ("started", ctypes.c_double),
        ("done", ctypes.c_longlong),
        ("accepted", ctypes.c_longlong),
        ("seconds", ctypes.c_double),
        ("slowest", ctypes.c_double),
        ("memory", ctypes.c_longlong),
    )
    index: int
    started: float
    done: int
    accepted: int
    seconds: float
    slowest: float
    memory: int


def work(share: Share, first: int, progress: Progress, found: Connection, folder: str) -> None:
    """Read the inputs of a share from `first` on; end early after one that took too much memory.

    progress  started is 0 while nothing is being read
    found     gets (index, problem)
    folder    for the input and TRACE
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    prepare_process()
    os.environ["TMPDIR"] = tempfile.tempdir = folder
    reader = Reader.named(share.source, share.reader)
    with open(Path(folder, TRACE), "w") as trace:
        faulthandler.enable(trace)
        faulthandler.register(signal.SIGUSR1, trace)
        for index in range(first, share.end):
            file, entry = share.input(index)
            path = Path(folder, f"input{file.suffix}")
            file.write(path)
            progress.index = index

            def begun() -> None:
                progress.started = time.monotonic()

            constant = reader.constant(entry)
            reading = read(reader.entries[entry][0], path, constant, begun)
            progress.started = 0.0
            progress.done += 1
            progress.accepted += reading.accepted
            progress.seconds += reading.seconds
            progress.slowest = max(progress.slowest, reading.seconds)
            progress.memory = max(progress.memory, reading.memory)
            if reading.problem:
                found.send((index, reading.problem))
            path.unlink()
            if reading.memory > constant:
                return  # the next must not hide behind this one's peak
    progress.index = share.end
