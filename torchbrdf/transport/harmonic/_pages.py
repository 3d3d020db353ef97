"""Pages of a file that is mapped into memory."""

import mmap
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor


@dataclass(frozen=True)
class Pages:
    """A part of a mapped file, by the bytes where it starts and ends."""

    mapping: mmap.mmap
    start: int
    end: int

    def release(self) -> None:
        """They leave the memory of this process; they stay in the system's cache, and come back when they are read."""
        if hasattr(mmap, "MADV_DONTNEED"):
            start = self.start // mmap.PAGESIZE * mmap.PAGESIZE
            self.mapping.madvise(mmap.MADV_DONTNEED, start, self.end - start)


def mapped_values(path: Path, count: int) -> tuple[Tensor, Pages]:
    """(count,) float32: what a file ends with, and its pages. Raises OSError or ValueError where that cannot be."""
    with open(path, "rb") as file:
        mapping = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
    start = len(mapping) - 4 * count
    return torch.frombuffer(mapping, dtype=torch.float32, offset=start), Pages(mapping, start, len(mapping))
