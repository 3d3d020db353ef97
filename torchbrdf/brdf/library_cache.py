"""The memory-mapped, cell-major cache of a library: one row a cell, one float16 column a basis BRDF.

A column is stored divided by a power of two that puts its largest value near 2^11: then float16 has 11
significant bits (relative error at most 2^-11 = 4.9e-4) down to 2^-25 of the peak. A cache folder is built under a
lock in a temporary folder and renamed, so what carries the final name is finished.
"""

import hashlib
import json
import mmap
import shutil
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor
from tqdm import tqdm

from torchbrdf.brdf.column_sources import ROW_CELLS, ColumnSource
from torchbrdf.brdf.gram import lower_gram
from torchbrdf.brdf.merl import LARGEST, nearest_measured
from torchbrdf.brdf.merl_grid import GRID, N_CELLS
from torchbrdf.files import OTHER_DISK, check_room, replacing_folder

FORMAT = 1
_TARGET_EXPONENT = 11


@dataclass(frozen=True, eq=False)
class StoredColumns:
    """All columns of a library.

    names        m materials; column 3 i + c is channel c of material i
    columns      (N_CELLS, n)  float16, f_r / scale; unmeasured cells hold their nearest measured neighbour
    scale        (n,)          float64, powers of two
    gram         (n, n)        float64, B^T B over the cells that every material measured
    valid        (m, N_CELLS / 8)  uint8, measured cells as packed bits
    fingerprint  sha256 of names, scale and columns
    """

    names: tuple[str, ...]
    columns: Tensor
    scale: Tensor
    gram: Tensor
    valid: Tensor
    fingerprint: str
    mapping: mmap.mmap | None = None

    def prefetch(self) -> None:
        """Ask the system to read the columns ahead: page by page, as a first gather would, takes far longer."""
        if self.mapping is not None and hasattr(mmap, "MADV_WILLNEED"):
            self.mapping.madvise(mmap.MADV_WILLNEED)

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


def open_or_build(source: ColumnSource, folder: Path, progress: bool) -> StoredColumns:
    """The cache in `folder`, built first where it is absent, damaged or older than its sources."""
    from filelock import FileLock

    folder.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(folder.with_suffix(".lock")):
        if not _is_current(folder, source.stamp):
            for leftover in folder.parent.glob(f".{folder.name}.*"):
                shutil.rmtree(leftover, ignore_errors=True)
            _build_folder(source, folder, progress)
        return _open(folder)


def build_in_memory(source: ColumnSource) -> StoredColumns:
    """The same columns without a file, for a few tables."""
    columns = torch.empty(N_CELLS, 3 * len(source.names), dtype=torch.float16)

    def write(i: int, rows: Tensor) -> None:
        columns[i * ROW_CELLS : (i + 1) * ROW_CELLS] = rows

    scale, gram, valid = _convert(source, write, progress=False)
    _fill(columns, valid)
    return StoredColumns(source.names, columns, scale, gram, _pack(valid), _fingerprint(source.names, scale, columns))


def _is_current(folder: Path, stamp: str) -> bool:
    try:
        manifest = json.loads((folder / "manifest.json").read_text())
        size = (folder / "columns.f16").stat().st_size
        with safe_open(folder / "library.safetensors", "pt") as tensors:
            sound = set(tensors.keys()) == {"scale", "gram", "valid"}
            peak = float(tensors.get_tensor("scale").max()) * 2**_TARGET_EXPONENT
    except (OSError, ValueError, SafetensorError):
        return False
    expected = (FORMAT, stamp, 2 * N_CELLS * 3 * len(manifest.get("names", [])))
    return sound and peak <= LARGEST and (manifest.get("format"), manifest.get("stamp"), size) == expected


def _open(folder: Path) -> StoredColumns:
    manifest = json.loads((folder / "manifest.json").read_text())
    names = tuple(manifest["names"])
    mapping, columns = _map(folder / "columns.f16", mmap.ACCESS_COPY, len(names))
    tensors = load_file(folder / "library.safetensors")
    return StoredColumns(names, columns, **tensors, fingerprint=manifest["fingerprint"], mapping=mapping)


def _map(path: Path, access: int, n_materials: int) -> tuple[mmap.mmap, Tensor]:
    """The columns in a file: ACCESS_WRITE changes the file, ACCESS_COPY only reads it."""
    with open(path, "rb" if access == mmap.ACCESS_COPY else "r+b") as file:
        mapping = mmap.mmap(file.fileno(), 0, access=access)
    return mapping, torch.frombuffer(mapping, dtype=torch.float16).view(N_CELLS, 3 * n_materials)


def _build_folder(source: ColumnSource, folder: Path, progress: bool) -> None:
    stamp = source.stamp
    check_room(folder.parent, 1.05 * 2 * N_CELLS * 3 * len(source.names), "the library cache")
    with replacing_folder(folder, OTHER_DISK) as temporary:
        with open(temporary / "columns.f16", "wb") as file, ThreadPoolExecutor(1) as writer:
            written: list[Future[None]] = []

            def write(_: int, rows: Tensor) -> None:
                """While the next row is computed."""
                for earlier in written:
                    earlier.result()
                written[:] = [writer.submit(rows.numpy().tofile, file)]

            scale, gram, valid = _convert(source, write, progress)
            written[0].result()
        _, columns = _map(temporary / "columns.f16", mmap.ACCESS_WRITE, len(source.names))
        _fill(columns, valid)
        save_file({"scale": scale, "gram": gram, "valid": _pack(valid)}, temporary / "library.safetensors")
        manifest = {
            "format": FORMAT,
            "stamp": stamp,
            "names": source.names,
            "fingerprint": _fingerprint(source.names, scale, columns),
        }
        (temporary / "manifest.json").write_text(json.dumps(manifest))


def _convert(
    source: ColumnSource, write: Callable[[int, Tensor], None], progress: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Write every theta_h row of the columns as float16; returns scale (n,), gram (n, n), valid (m, N_CELLS)."""
    m = len(source.names)
    with tqdm(total=m + GRID[0], desc="material library", disable=not progress, leave=False) as bar:
        peaks, valid = [], torch.empty(m, N_CELLS, dtype=torch.bool)
        for material in range(m):
            peak, valid[material] = source.scan(material)
            peaks.append(peak)
            bar.update()
        peak = torch.cat(peaks).double()
        scale = torch.exp2(torch.floor(torch.log2(torch.where(peak > 0, peak, 1.0))) - _TARGET_EXPONENT)
        everywhere = valid.all(0).reshape(GRID[0], ROW_CELLS)
        gram = torch.zeros(3 * m, 3 * m, dtype=torch.float64)
        for i in range(GRID[0]):
            row = source.row(i)
            measured = row[everywhere[i]].double()
            gram += lower_gram(measured.T)
            write(i, (row / scale.to(row.dtype)).half())  # exact but for the last step: of a power of two
            bar.update()
    return scale, gram.tril() + gram.tril(-1).T, valid


def _fill(columns: Tensor, valid: Tensor) -> None:
    """Give unmeasured cells the value of their nearest measured neighbour, in place."""
    alike: dict[bytes, list[int]] = {}
    for material, bits in enumerate(_pack(valid).numpy()):
        alike.setdefault(bits.tobytes(), []).append(material)
    for materials in alike.values():
        holes = torch.nonzero(~valid[materials[0]]).ravel()
        source = nearest_measured(valid[materials[0]])[holes]
        which = columns_of(materials)
        if len(which) == columns.shape[1]:
            columns[holes] = columns[source]
        else:
            columns[holes[:, None], which] = columns[source[:, None], which]


def _pack(valid: Tensor) -> Tensor:
    return torch.from_numpy(np.packbits(valid.numpy(), axis=1))


def _fingerprint(names: tuple[str, ...], scale: Tensor, columns: Tensor) -> str:
    digest = hashlib.sha256(repr(names).encode() + scale.numpy().tobytes())
    for start in range(0, N_CELLS, ROW_CELLS):
        digest.update(columns[start : start + ROW_CELLS].numpy().tobytes())
    return digest.hexdigest()
