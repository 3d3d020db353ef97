"""Where the columns of B come from: MERL files, tables in memory, or the embedded library."""

import hashlib
import math
import os
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import IO, Protocol

import numpy as np
import torch
from torch import Tensor

from torchbrdf.brdf.merl import CHANNEL_SCALE, MerlTable, read_planes
from torchbrdf.brdf.merl_grid import GRID, N_CELLS, above_horizon
from torchbrdf.brdf.settings import RGL_SUFFIX
from torchbrdf.brdf.stored_columns import ROW_CELLS, columns_of
from torchbrdf.brdf.tables import read_table
from torchbrdf.brdf.tucker import MODEL_VERSION, load_default_factors
from torchbrdf.files import cache_folder, existing_file


@dataclass(frozen=True)
class Extent:
    """What of a material is known before its columns are stored.

    peak      (3,) the largest f_r of each channel
    measured  (N_CELLS,) bool
    said      what reading it warned of
    """

    peak: Tensor
    measured: Tensor
    said: tuple[str, ...] = ()

    @classmethod
    def of(cls, table: MerlTable, said: tuple[str, ...] = ()) -> "Extent":
        """Of a table in memory."""
        unmeasured = ~table.valid
        peak = [channel.masked_fill(unmeasured, -math.inf).amax() for channel in table.values.unbind(-1)]
        return cls(torch.stack(peak), table.valid.reshape(N_CELLS), said)


class ColumnSource(Protocol):
    """m materials as n = 3 m columns, read one theta_h row at a time so that memory stays bounded."""

    names: tuple[str, ...]

    @property
    def stamp(self) -> str:
        """Changes whenever the columns may have changed; costs no reading of the columns."""
        ...

    @property
    def stamps(self) -> tuple[str, ...]:
        """One a material, whatever its name: changes whenever its columns may have; costs no reading of them."""
        ...

    def scan(self, material: int) -> Extent:
        """Of one material, before any row is read."""
        ...

    def row(self, i: int) -> Tensor:
        """(ROW_CELLS, n) float32 or float64: row i of all columns; unmeasured cells hold anything finite."""
        ...

    def subset(self, materials: Sequence[int]) -> "ColumnSource":
        """Some of the materials."""
        ...


class MerlSource:
    """Tables in files; those of the RGL database are tabulated to a temporary file when they are scanned."""

    def __init__(self, paths: Sequence[Path], names: Sequence[str]) -> None:
        """Keep the paths, which are sound or not: `scan` tells."""
        self.paths, self.names = list(paths), tuple(names)
        self._converted: dict[int, int] = {}
        self._spool: IO[bytes] | None = None

    @property
    def stamp(self) -> str:
        """Names, sizes and modification times."""
        return _digest([(path.name, *_state(path)) for path in self.paths])

    @property
    def stamps(self) -> tuple[str, ...]:
        """Where each file lies, its size and modification time."""
        return tuple(_digest((str(path.resolve()), *_state(path))) for path in self.paths)

    def scan(self, material: int) -> Extent:
        """Validates the file: see `read_table`."""
        path = self.paths[material]
        if path.suffix.lower() != RGL_SUFFIX:
            return Extent.of(read_table(path))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            table = read_table(path)
        self._spool = self._spool or tempfile.TemporaryFile(dir=cache_folder())  # noqa: SIM115 - is gone with the source
        self._converted[material] = self._spool.seek(0, os.SEEK_END)
        table.values.float().contiguous().numpy().tofile(self._spool)
        self._spool.flush()
        return Extent.of(table, tuple(str(warning.message).removeprefix(f"{path}: ") for warning in caught))

    def row(self, i: int) -> Tensor:
        """Read with plain file access: memory-mapping 100 tables would count as 3.5 GB of resident memory."""
        row = np.empty((ROW_CELLS, 3 * len(self.paths)))
        for material, path in enumerate(self.paths):
            columns = row[:, 3 * material : 3 * material + 3]
            if material in self._converted and self._spool is not None:
                self._spool.seek(self._converted[material] + 12 * i * ROW_CELLS)
                columns[:] = np.fromfile(self._spool, "<f4", 3 * ROW_CELLS).reshape(ROW_CELLS, 3)
            else:
                np.multiply(read_planes(path, i * ROW_CELLS, ROW_CELLS).T, CHANNEL_SCALE, out=columns)
        return torch.from_numpy(row)

    def subset(self, materials: Sequence[int]) -> "MerlSource":
        """See ColumnSource."""
        return MerlSource([self.paths[i] for i in materials], [self.names[i] for i in materials])


class StampedSource:
    """Materials of which caches hold some, by their stamps, and a source the others."""

    def __init__(self, names: Sequence[str], held: Mapping[str, str], source: MerlSource) -> None:
        """In the order of the names; held: stamps of those in caches, by their names."""
        self.names, self.held, self.source = tuple(names), held, source

    @property
    def stamp(self) -> str:
        """Of all stamps and names."""
        return _digest((self.names, self.stamps))

    @property
    def stamps(self) -> tuple[str, ...]:
        """See ColumnSource."""
        known = {**self.held, **dict(zip(self.source.names, self.source.stamps, strict=True))}
        return tuple(known[name] for name in self.names)

    def scan(self, material: int) -> Extent:
        """See ColumnSource."""
        return self.source.scan(material)

    def row(self, i: int) -> Tensor:
        """See ColumnSource."""
        return self.source.row(i)

    def subset(self, materials: Sequence[int]) -> MerlSource:
        """See ColumnSource; of none that caches hold."""
        return self.source.subset([self.source.names.index(self.names[i]) for i in materials])


class TableSource:
    """Tables that are already in memory."""

    def __init__(self, tables: Sequence[MerlTable]) -> None:
        """Keep the tables."""
        self.tables = tables
        self.names = tuple(table.name for table in tables)

    @property
    def stamp(self) -> str:
        """Names and values."""
        return _digest((self.names, self.stamps))

    @property
    def stamps(self) -> tuple[str, ...]:
        """Of the values."""
        return tuple(hashlib.sha256(table.values.contiguous().numpy().tobytes()).hexdigest() for table in self.tables)

    def subset(self, materials: Sequence[int]) -> "TableSource":
        """See ColumnSource."""
        return TableSource([self.tables[i] for i in materials])

    def scan(self, material: int) -> Extent:
        """See ColumnSource."""
        return Extent.of(self.tables[material])

    def row(self, i: int) -> Tensor:
        """See ColumnSource."""
        return torch.cat([table.values[i].reshape(ROW_CELLS, 3).double() for table in self.tables], dim=1)


class EmbeddedSource:
    """The embedded library, expanded to the cells of the grid."""

    _HEADROOM = 4.0
    """Above the largest value on every tenth row, which is what `scan` looks at."""

    def __init__(self) -> None:
        """Read the factors that come with the package."""
        self.names, self.factors = load_default_factors()
        self._kept: dict[int, Tensor] = {}

    @cached_property
    def stamp(self) -> str:
        """The factors, and the version of the model that reads them."""
        digest = hashlib.sha256(f"{MODEL_VERSION} {self.names}".encode())
        for name, values in self.factors.tensors.items():
            digest.update(name.encode() + values.contiguous().numpy().tobytes())
        return digest.hexdigest()

    @property
    def stamps(self) -> tuple[str, ...]:
        """The version, and where among the factors."""
        return tuple(f"{self.stamp} {i}" for i in range(len(self.names)))

    def subset(self, materials: Sequence[int]) -> "EmbeddedSource":
        """See ColumnSource."""
        some = EmbeddedSource()
        some.names = tuple(self.names[i] for i in materials)
        some.factors = self.factors.subset(columns_of(materials))
        return some

    @cached_property
    def _peaks(self) -> Tensor:
        """(m, 3): a bound of the largest f_r. Keeps the rows, 20 MB each, until `row` is asked for them."""
        peak = torch.zeros(3 * len(self.names), dtype=torch.float64)
        valid = above_horizon().reshape(GRID[0], ROW_CELLS)
        for i in range(0, GRID[0], 10):
            self._kept[i] = self.row(i)
            peak = torch.maximum(peak, self._kept[i][valid[i]].amax(0).double())
        return (self._HEADROOM * peak).reshape(-1, 3)

    def scan(self, material: int) -> Extent:
        """See ColumnSource."""
        return Extent(self._peaks[material], above_horizon().reshape(N_CELLS))

    def row(self, i: int) -> Tensor:
        """See ColumnSource."""
        kept = self._kept.pop(i, None)
        return self.factors.row(i) if kept is None else kept


def _state(path: Path) -> tuple[int, ...]:
    """Changes whenever what is read from a file may have changed. Raises as `existing_file` where it is gone."""
    try:
        found = path.stat()
    except OSError:
        existing_file(path, "a measured table")
        raise
    if path.suffix.lower() != RGL_SUFFIX:
        return found.st_size, found.st_mtime_ns
    from torchbrdf.brdf.rgl_table import TABULATION

    return found.st_size, found.st_mtime_ns, TABULATION


def _digest(state: object) -> str:
    return hashlib.sha256(repr(state).encode()).hexdigest()
