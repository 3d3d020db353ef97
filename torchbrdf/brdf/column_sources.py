"""Where the columns of B come from: MERL files, tables in memory, or the embedded library."""

import hashlib
import os
from collections.abc import Sequence
from functools import cached_property
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from torchbrdf.brdf.merl import CHANNEL_SCALE, MerlTable, read_planes
from torchbrdf.brdf.merl_directory import table_paths
from torchbrdf.brdf.merl_grid import GRID, N_CELLS, above_horizon
from torchbrdf.brdf.tucker import MODEL_VERSION, load_default_factors

ROW_CELLS = GRID[1] * GRID[2]
"""Cells of one theta_h row of the grid."""


class ColumnSource(Protocol):
    """m materials as n = 3 m columns, read one theta_h row at a time so that memory stays bounded."""

    names: tuple[str, ...]

    @property
    def stamp(self) -> str:
        """Changes whenever the columns may have changed; costs no reading of the columns."""
        ...

    def scan(self, material: int) -> tuple[Tensor, Tensor]:
        """The largest f_r of each channel (3,) and the measured cells (N_CELLS,) bool of one material."""
        ...

    def row(self, i: int) -> Tensor:
        """(ROW_CELLS, n) float32 or float64: row i of all columns; unmeasured cells hold anything finite."""
        ...


class MerlSource:
    """A directory of MERL tables; `folder` is where they lie, perhaps one folder down."""

    def __init__(self, directory: str | os.PathLike[str]) -> None:
        """Find the files; raises as `table_paths`."""
        self.paths = table_paths(directory)
        self.folder = self.paths[0].parent
        self.names = tuple(path.stem for path in self.paths)

    @property
    def stamp(self) -> str:
        """Names, sizes and modification times."""
        states = [(path.name, path.stat().st_size, path.stat().st_mtime_ns) for path in self.paths]
        return hashlib.sha256(repr(states).encode()).hexdigest()

    def scan(self, material: int) -> tuple[Tensor, Tensor]:
        """Validates the file: see MerlTable.open."""
        table = MerlTable.open(self.paths[material])
        return _extent(table)

    def row(self, i: int) -> Tensor:
        """Read with plain file access: memory-mapping 100 tables would count as 3.5 GB of resident memory."""
        planes = [read_planes(path, i * ROW_CELLS, ROW_CELLS) for path in self.paths]
        return torch.from_numpy(np.concatenate(planes).T * np.tile(CHANNEL_SCALE, len(self.paths)))


class TableSource:
    """Tables that are already in memory."""

    def __init__(self, tables: Sequence[MerlTable]) -> None:
        """Keep the tables."""
        self.tables = tables
        self.names = tuple(table.name for table in tables)

    @property
    def stamp(self) -> str:
        """Names and values."""
        digest = hashlib.sha256(repr(self.names).encode())
        for table in self.tables:
            digest.update(table.values.contiguous().numpy().tobytes())
        return digest.hexdigest()

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
