"""Where the columns of B come from: MERL files, tables in memory, or the embedded library."""

import hashlib
import os
import tempfile
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import IO, Protocol

import numpy as np
import torch
from torch import Tensor

from torchbrdf.brdf.merl import CHANNEL_SCALE, MerlTable, read_planes
from torchbrdf.brdf.merl_grid import GRID, N_CELLS, above_horizon
from torchbrdf.brdf.tables import read_table
from torchbrdf.brdf.tucker import MODEL_VERSION, load_default_factors
from torchbrdf.files import cache_folder

ROW_CELLS = GRID[1] * GRID[2]
"""Cells of one theta_h row of the grid."""

_MERL_SUFFIX = ".binary"
"""Of files whose rows are read where they lie."""


def columns_of(materials: Sequence[int]) -> Tensor:
    """(3 len(materials),) int64: the R, G and B columns of materials, given by their positions."""
    return (3 * torch.tensor(materials, dtype=torch.int64)[:, None] + torch.arange(3)).ravel()


def shared_cells(valid: Tensor) -> Tensor:
    """(N_CELLS,) bool: measured in all of some materials, of packed bits (m, N_CELLS / 8)."""
    return torch.from_numpy(np.unpackbits(np.bitwise_and.reduce(valid.numpy(), axis=0)).view(bool))


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

    def scan(self, material: int) -> tuple[Tensor, Tensor]:
        """The largest f_r of each channel (3,) and the measured cells (N_CELLS,) bool of one material."""
        ...

    def row(self, i: int) -> Tensor:
        """(ROW_CELLS, n) float32 or float64: row i of all columns; unmeasured cells hold anything finite."""
        ...

    def subset(self, materials: Sequence[int]) -> "ColumnSource":
        """Some of the materials."""
        ...


class MerlSource:
    """Tables in files; when scanned, those that are not `.binary` are converted to a temporary file."""

    def __init__(self, paths: Sequence[Path], names: Sequence[str]) -> None:
        """Keep the paths, which are sound or not: `scan` tells."""
        self.paths, self.names = list(paths), tuple(names)
        self._converted: dict[int, int] = {}
        self._spool: IO[bytes] | None = None

    @property
    def stamp(self) -> str:
        """Names, sizes and modification times."""
        states = [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in self.paths]
        return hashlib.sha256(repr(states).encode()).hexdigest()

    @property
    def stamps(self) -> tuple[str, ...]:
        """Where each file lies, its size and modification time."""
        states = [(str(path.resolve()), path.stat().st_size, path.stat().st_mtime_ns) for path in self.paths]
        return tuple(hashlib.sha256(repr(state).encode()).hexdigest() for state in states)

    def scan(self, material: int) -> tuple[Tensor, Tensor]:
        """Validates the file: see `read_table`."""
        path = self.paths[material]
        table = read_table(path)
        if path.suffix.lower() != _MERL_SUFFIX:
            self._spool = self._spool or tempfile.TemporaryFile(dir=cache_folder())  # noqa: SIM115 - is gone with the source
            self._converted[material] = self._spool.seek(0, os.SEEK_END)
            table.values.float().contiguous().numpy().tofile(self._spool)
            self._spool.flush()
        return _extent(table)

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
    """Materials under given names and stamps, of which a source has those that no cache does."""

    def __init__(self, names: tuple[str, ...], stamps: tuple[str, ...], source: MerlSource) -> None:
        """Those of the source are known by their names."""
        self.names, self.stamps, self.source = names, stamps, source
        self.stamp = hashlib.sha256(repr((names, stamps)).encode()).hexdigest()

    def scan(self, material: int) -> tuple[Tensor, Tensor]:
        """See ColumnSource."""
        return self.source.scan(material)

    def row(self, i: int) -> Tensor:
        """See ColumnSource."""
        return self.source.row(i)

    def subset(self, materials: Sequence[int]) -> MerlSource:
        """See ColumnSource. Raises ValueError where it asks for what lay in a cache that is gone."""
        places = [self.source.names.index(self.names[i]) for i in materials if self.names[i] in self.source.names]
        if len(places) < len(materials):
            raise ValueError("a library that was to be taken from the cache is no longer there; open it again")
        return self.source.subset(places)


class TableSource:
    """Tables that are already in memory."""

    def __init__(self, tables: Sequence[MerlTable]) -> None:
        """Keep the tables."""
        self.tables = tables
        self.names = tuple(table.name for table in tables)

    @property
    def stamp(self) -> str:
        """Names and values."""
        return hashlib.sha256(repr((self.names, self.stamps)).encode()).hexdigest()

    @property
    def stamps(self) -> tuple[str, ...]:
        """Of the values."""
        return tuple(hashlib.sha256(table.values.contiguous().numpy().tobytes()).hexdigest() for table in self.tables)

    def subset(self, materials: Sequence[int]) -> "TableSource":
        """See ColumnSource."""
        return TableSource([self.tables[i] for i in materials])

    def scan(self, material: int) -> tuple[Tensor, Tensor]:
        """See ColumnSource."""
        return _extent(self.tables[material])

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

    @property
    def stamp(self) -> str:
        """The factors, and the version of the model that reads them."""
        digest = hashlib.sha256(f"{MODEL_VERSION} {self.names}".encode())
        for name, values in self.factors.tensors.items():
            digest.update(name.encode() + values.contiguous().numpy().tobytes())
        return digest.hexdigest()

    @property
    def stamps(self) -> tuple[str, ...]:
        """The version, and where among the factors."""
        stamp = self.stamp
        return tuple(f"{stamp} {i}" for i in range(len(self.names)))

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

    def scan(self, material: int) -> tuple[Tensor, Tensor]:
        """See ColumnSource."""
        return self._peaks[material], above_horizon().reshape(N_CELLS)

    def row(self, i: int) -> Tensor:
        """See ColumnSource."""
        kept = self._kept.pop(i, None)
        return self.factors.row(i) if kept is None else kept


def _extent(table: MerlTable) -> tuple[Tensor, Tensor]:
    return table.values[table.valid].amax(0), table.valid.reshape(N_CELLS)
