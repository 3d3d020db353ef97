"""The columns of a library as they are kept: float16, a power of two apart, one row a cell."""

import hashlib
import mmap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchbrdf.brdf.merl_grid import GRID, N_CELLS

ROW_CELLS = GRID[1] * GRID[2]
"""Cells of one theta_h row of the grid."""


@dataclass(frozen=True)
class Part:
    """Materials of a library that are those of an earlier one, with the same columns.

    fingerprint  of the earlier library
    theirs       positions there
    mine         positions in the library that holds the part
    """

    fingerprint: str
    theirs: tuple[int, ...]
    mine: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class StoredColumns:
    """All columns of a library.

    names        m materials; column 3 i + c is channel c of material i
    columns      (N_CELLS, n)  float16, f_r / scale; unmeasured cells hold their nearest measured neighbour
    scale        (n,)          float64, powers of two
    gram         (n, n)        float64, B^T B over the cells that every material measured
    valid        (m, N_CELLS / 8)  uint8, measured cells as packed bits
    fingerprint  sha256 of names, scale and columns
    stamps       (m) what each material was made from, see `ColumnSource`
    said         (m) what each material's table is to be warned of
    same         pairs of materials that are one measurement
    parts        the earlier libraries from which columns were taken, and what came new; () where all is new
    folder       of the cache that is mapped, None where all is in memory

    Not to be written to: a deep copy is the same object. What a pickle of what is mapped holds, `library_cache` says.
    """

    names: tuple[str, ...]
    columns: Tensor
    scale: Tensor
    gram: Tensor
    valid: Tensor
    fingerprint: str
    mapping: mmap.mmap | None = None
    stamps: tuple[str, ...] = ()
    said: tuple[tuple[str, ...], ...] = ()
    same: tuple[tuple[int, int], ...] = ()
    parts: tuple[Part, ...] = ()
    folder: Path | None = None

    def __deepcopy__(self, memo: dict[int, Any]) -> "StoredColumns":
        """The same, mapped once."""
        return self

    def prefetch(self) -> None:
        """Ask the system to read the columns ahead: page by page, as a first gather would, takes far longer."""
        if self.mapping is not None and hasattr(mmap, "MADV_WILLNEED"):
            self.mapping.madvise(mmap.MADV_WILLNEED)

    def release(self) -> None:
        """Columns that were read leave the memory of this process; they stay in the system's cache."""
        release(self.mapping)

    def of(self, materials: Sequence[int]) -> "StoredColumns":
        """Some of the materials, in memory."""
        which = columns_of(materials)
        names, scale = tuple(self.names[i] for i in materials), self.scale[which]
        columns = torch.cat([rows[:, which].cpu() for _, rows in self.blocks(ROW_CELLS, keep=False)])
        return StoredColumns(
            names, columns, scale, self.gram[which][:, which], self.valid[list(materials)],
            fingerprint_of(names, scale, columns),
        )  # fmt: skip

    def blocks(self, cells: int, keep: bool = True) -> Iterator[tuple[int, Tensor]]:
        """The first cell and the rows (cells, n) of all blocks of so many cells.

        keep  False: a block that was read leaves the memory of this process at once, where columns are mapped; it
              stays in the system's cache. Reading takes twice as long, and 100 materials count for 880 MB less
        """
        given_back = 0
        for start in range(0, N_CELLS, cells):
            rows = self.columns[start : start + cells]
            yield start, rows
            if not keep and self.mapping is not None and hasattr(mmap, "MADV_DONTNEED"):
                size = (start * rows.stride(0) + rows.numel()) * rows.element_size() // mmap.PAGESIZE * mmap.PAGESIZE
                self.mapping.madvise(mmap.MADV_DONTNEED, given_back, size - given_back)
                given_back = size


def columns_of(materials: Sequence[int]) -> Tensor:
    """(3 len(materials),) int64: the R, G and B columns of materials, given by their positions."""
    return (3 * torch.tensor(materials, dtype=torch.int64)[:, None] + torch.arange(3)).ravel()


def shared_cells(valid: Tensor) -> Tensor:
    """(N_CELLS,) bool: measured in all of some materials, of packed bits (m, N_CELLS / 8)."""
    return unpacked(torch.from_numpy(np.bitwise_and.reduce(valid.numpy(), axis=0)))


def unpacked(bits: Tensor) -> Tensor:
    """(..., 8 k) bool of packed bits (..., k) uint8."""
    return torch.from_numpy(np.unpackbits(bits.numpy(), axis=-1).view(bool))


def release(mapping: mmap.mmap | None) -> None:
    """See `StoredColumns.release`."""
    if mapping is not None and hasattr(mmap, "MADV_DONTNEED"):
        mapping.madvise(mmap.MADV_DONTNEED)


def fingerprint_of(
    names: tuple[str, ...],
    scale: Tensor,
    columns: Tensor,
    mapping: mmap.mmap | None = None,
    which: Tensor | None = None,
) -> str:
    """See `StoredColumns`; which: of some of the columns (N_CELLS, n), whose scale (k,) is given."""
    digest = hashlib.sha256(repr(names).encode() + scale.numpy().tobytes())
    for start in range(0, N_CELLS, ROW_CELLS):
        rows = columns[start : start + ROW_CELLS]
        digest.update((rows if which is None else rows[:, which]).numpy().data)
        release(mapping)
    return digest.hexdigest()
