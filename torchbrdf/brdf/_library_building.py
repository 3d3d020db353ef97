"""The columns of a library, made a theta_h row at a time from a source and from earlier libraries that hold them."""

import mmap
from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from torchbrdf.brdf._remarks import brightness, holes
from torchbrdf.brdf._reused_columns import GramSum, reusable
from torchbrdf.brdf.albedo import albedo_of
from torchbrdf.brdf.column_sources import ColumnSource
from torchbrdf.brdf.merl import nearest_measured
from torchbrdf.brdf.merl_grid import GRID, N_CELLS, measured_share
from torchbrdf.brdf.sameness import same_measurements, sampled_cells
from torchbrdf.brdf.stored_columns import (
    ROW_CELLS,
    Part,
    StoredColumns,
    columns_of,
    fingerprint_of,
    release,
    shared_cells,
    unpacked,
)
from torchbrdf.progress import progress_bar

TARGET_EXPONENT = 11
"""Of two: where the largest value of a column is, divided by its scale."""

_CELLS_AT_ONCE = 256
"""Far from each other: the system reads ahead, and maps what is around each."""


class Build:
    """A library in the making: `convert`, then `finished`.

    scale (n,), gram (n, n), valid (m, N_CELLS / 8), said (m)  as in `StoredColumns`
    """

    scale: Tensor
    gram: Tensor
    valid: Tensor
    said: list[tuple[str, ...]]

    def __init__(self, source: ColumnSource, stamps: Sequence[str], known: Sequence[StoredColumns]) -> None:
        """Of the materials of a source, by their stamps; those in known libraries are not read."""
        self.names, self.stamps = source.names, tuple(stamps)
        self.reused, self.fresh = reusable(stamps, known) if known else ([], list(range(len(source.names))))
        self.source = source if len(self.fresh) == len(source.names) else source.subset(self.fresh)

    def convert(self, write: Callable[[int, Tensor], None], progress: bool) -> None:
        """Write every row of the columns as float16; those of new materials are not yet filled."""
        m = len(self.names)
        with progress_bar(total=len(self.fresh) + GRID[0], desc="steps of the material library", shown=progress) as bar:
            self.scale = torch.ones(3 * m, dtype=torch.float64)
            self.valid = torch.empty(m, N_CELLS // 8, dtype=torch.uint8)
            self.said = [()] * m
            for part in self.reused:
                self.scale[columns_of(part.mine)] = part.stored.scale.cpu()[columns_of(part.theirs)]
                self.valid[list(part.mine)] = part.stored.valid[list(part.theirs)]
                for mine, theirs in zip(part.mine, part.theirs, strict=True) if part.stored.said else ():
                    self.said[mine] = part.stored.said[theirs]
            for i, material in enumerate(self.fresh):
                extent = self.source.scan(i)
                self.valid[material] = torch.from_numpy(np.packbits(extent.measured.numpy()))
                self.scale[3 * material : 3 * material + 3] = _scale_of(extent.peak.double())
                self.said[material] = extent.said
                bar.update()
            everywhere = self._shared_cells()
            total = GramSum(self.scale, everywhere, self.reused, columns_of(self.fresh))
            for i in range(GRID[0]):
                halves, exact = self._row(i)
                total.add(slice(i * ROW_CELLS, (i + 1) * ROW_CELLS), halves, exact)
                write(i, halves)
                bar.update()
        if not total.exact:
            total = GramSum(self.scale, everywhere, [], columns_of(self.fresh))
            for i in range(GRID[0]):
                total.add(slice(i * ROW_CELLS, (i + 1) * ROW_CELLS), *self._row(i))
        self.gram = total.total()

    def _shared_cells(self) -> Tensor:
        """(N_CELLS,) bool. Raises ValueError where no cell was measured in all materials."""
        everywhere = shared_cells(self.valid)
        if not everywhere.any():
            fewest = min(range(len(self.names)), key=lambda i: int(shared_cells(self.valid[[i]]).sum()))
            raise ValueError(
                f"no cell was measured in all of these {len(self.names)} materials, so they have no classes; "
                f"{self.names[fewest]} measured fewest: take its file away"
            )
        return everywhere

    def _row(self, i: int) -> tuple[Tensor, Tensor]:
        """Row i of f_r / scale: of all columns as float16, and of the new ones before they are rounded."""
        fresh = self.source.row(i) if self.fresh else torch.empty(ROW_CELLS, 0)
        which = columns_of(self.fresh)
        exact = fresh / self.scale[which].to(fresh.dtype)  # which is a power of two
        if not self.reused:
            return exact.half(), exact
        halves = torch.empty(ROW_CELLS, 3 * len(self.names), dtype=torch.float16)
        halves[:, which] = exact.half()
        for part in self.reused:
            stored = part.stored.columns[i * ROW_CELLS : (i + 1) * ROW_CELLS]
            halves[:, _run(part.mine)] = stored[:, _run(part.theirs)].cpu()
            part.stored.release()
        return halves, exact

    def finished(self, columns: Tensor, mapping: mmap.mmap | None = None) -> StoredColumns:
        """The library of the columns that were written, which are filled in place."""
        fill(columns, self.valid, self.fresh, mapping)
        rows = reader(columns, mapping)
        for material, texts in zip(self.fresh, remarks(rows, self.scale, self.valid, self.fresh), strict=True):
            self.said[material] += texts
        same = same_in(rows, self.scale, self.valid)
        fingerprint = fingerprint_of(self.names, self.scale, columns, mapping)
        return StoredColumns(
            self.names, columns, self.scale, self.gram, self.valid, fingerprint, mapping, self.stamps,
            tuple(self.said), same, self._parts(columns, mapping),
        )  # fmt: skip

    def _parts(self, columns: Tensor, mapping: mmap.mmap | None) -> tuple[Part, ...]:
        """The libraries that were used, and what is new as one of its own."""
        parts = [part for reused in self.reused for part in reused.parts]
        if self.reused and self.fresh:
            which = columns_of(self.fresh)
            names = tuple(self.names[i] for i in self.fresh)
            key = fingerprint_of(names, self.scale[which], columns, mapping, which)
            parts.append(Part(key, tuple(range(len(self.fresh))), tuple(self.fresh)))
        return tuple(parts)


def build_in_memory(source: ColumnSource, known: Sequence[StoredColumns] = ()) -> StoredColumns:
    """A library without a file, for a few tables."""
    columns = torch.empty(N_CELLS, 3 * len(source.names), dtype=torch.float16)

    def write(i: int, rows: Tensor) -> None:
        columns[i * ROW_CELLS : (i + 1) * ROW_CELLS] = rows

    build = Build(source, source.stamps if known else (), known)
    build.convert(write, progress=False)
    return build.finished(columns)


def fill(columns: Tensor, valid: Tensor, materials: Sequence[int], mapping: mmap.mmap | None = None) -> None:
    """Give unmeasured cells of some materials the value of their nearest measured neighbour, in place."""
    alike: dict[bytes, list[int]] = {}
    for material in materials:
        alike.setdefault(valid[material].numpy().tobytes(), []).append(material)
    for some in alike.values():
        measured = shared_cells(valid[some[:1]])
        holes = torch.nonzero(~measured).ravel()
        source, which = nearest_measured(measured)[holes], _run(some)
        for cells, nearest in zip(holes.split(ROW_CELLS), source.split(ROW_CELLS), strict=True):
            if isinstance(which, slice):
                columns[:, which][cells] = columns[:, which][nearest]
            else:
                columns[cells[:, None], which] = columns[nearest[:, None], which]
            release(mapping)


def reader(columns: Tensor, mapping: mmap.mmap | None) -> Callable[[Tensor], Tensor]:
    """Columns in some cells; what was read for that leaves the memory of this process at once."""

    def rows(cells: Tensor) -> Tensor:
        found = columns[cells]
        release(mapping)
        return found

    return rows


def remarks(
    rows: Callable[[Tensor], Tensor], scale: Tensor, valid: Tensor, materials: Sequence[int]
) -> list[tuple[str, ...]]:
    """For each of some materials what to say of it, see `brightness` and `holes`.

    rows  f_r / scale (r, n) of all columns in cells (r,)
    """
    if not materials:
        return []
    which = _run(materials)
    albedo = albedo_of(lambda cells: rows(cells)[:, which]) * scale[which]
    each = zip(materials, albedo.split(3, dim=1), strict=True)
    return [tuple(filter(None, (brightness(one), holes(measured_share(shared_cells(valid[[i]])))))) for i, one in each]


def same_in(rows: Callable[[Tensor], Tensor], scale: Tensor, valid: Tensor) -> tuple[tuple[int, int], ...]:
    """Pairs of materials that are one measurement; rows as of `remarks`."""
    cells = sampled_cells()
    measured = torch.stack([unpacked(bits)[cells] for bits in valid])
    values = torch.cat([rows(some) for some in cells.split(_CELLS_AT_ONCE)])
    return tuple(same_measurements(values.double() * scale, measured))


def _run(materials: Sequence[int]) -> Tensor | slice:
    """The columns of materials: as a slice where they follow each other, which is copied ten times as fast."""
    first, last = materials[0], materials[-1]
    return slice(3 * first, 3 * last + 3) if list(materials) == list(range(first, last + 1)) else columns_of(materials)


def _scale_of(peak: Tensor) -> Tensor:
    return torch.exp2(torch.floor(torch.log2(torch.where(peak > 0, peak, 1.0))) - TARGET_EXPONENT)
