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
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor
from tqdm import tqdm

from torchbrdf.brdf._reused_columns import GramSum, Part, reusable
from torchbrdf.brdf.column_sources import ROW_CELLS, ColumnSource, columns_of, shared_cells
from torchbrdf.brdf.merl import LARGEST, nearest_measured
from torchbrdf.brdf.merl_grid import GRID, N_CELLS
from torchbrdf.files import OTHER_DISK, check_room, replacing_folder

FORMAT = 1
MIXTURE = "mixture-"
"""How the folders begin of libraries of several folders or files."""

_KEPT_MIXTURES = 8
"""The last ones that were opened: each change of what is mixed makes another, of 9 MB a material."""

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
    stamps       (m) what each material was made from, see `ColumnSource`
    parts        the earlier libraries from which columns were taken, and what came new; () where all is new
    """

    names: tuple[str, ...]
    columns: Tensor
    scale: Tensor
    gram: Tensor
    valid: Tensor
    fingerprint: str
    mapping: mmap.mmap | None = None
    stamps: tuple[str, ...] = ()
    parts: tuple[Part, ...] = ()

    def prefetch(self) -> None:
        """Ask the system to read the columns ahead: page by page, as a first gather would, takes far longer."""
        if self.mapping is not None and hasattr(mmap, "MADV_WILLNEED"):
            self.mapping.madvise(mmap.MADV_WILLNEED)

    def release(self) -> None:
        """Columns that were read leave the memory of this process; they stay in the system's cache."""
        _release(self.mapping)

    def of(self, materials: Sequence[int]) -> "StoredColumns":
        """Some of the materials, in memory."""
        which = columns_of(materials)
        names, scale = tuple(self.names[i] for i in materials), self.scale[which]
        columns = torch.cat([rows[:, which] for _, rows in self.blocks(ROW_CELLS, keep=False)])
        return StoredColumns(
            names, columns, scale, self.gram[which][:, which], self.valid[list(materials)],
            _fingerprint(names, scale, columns),
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


def open_or_build(
    source: ColumnSource, folder: Path, progress: bool, known: Sequence[StoredColumns] = ()
) -> StoredColumns:
    """The cache in `folder`, built first where it is absent, damaged or older than its sources.

    known  libraries whose columns are taken before those that other caches beside `folder` hold
    """
    from filelock import FileLock

    folder.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(folder.with_suffix(".lock")):
        stamps = source.stamps
        if not _is_current(folder, source.stamp):
            for leftover in folder.parent.glob(f".{folder.name}.*"):
                shutil.rmtree(leftover, ignore_errors=True)
            _build_folder(source, stamps, folder, progress, [*known, *_caches(folder.parent, stamps)])
            _clear(folder)
        with suppress(OSError):
            (folder / "manifest.json").touch()
        return replace(_open(folder), stamps=stamps)  # which caches of before 0.11 do not hold


def _clear(built: Path) -> None:
    """Remove the mixtures that were opened longest ago, but for `_KEPT_MIXTURES`; none that is being built."""
    from filelock import FileLock, Timeout

    manifests = [path for path in built.parent.glob(f"{MIXTURE}*/manifest.json") if path.parent != built]
    with suppress(OSError):
        newest_first = sorted(manifests, key=lambda path: path.stat().st_mtime, reverse=True)
        for path in newest_first[_KEPT_MIXTURES - 1 :]:
            with suppress(Timeout), FileLock(path.parent.with_suffix(".lock"), timeout=0):
                shutil.rmtree(path.parent, ignore_errors=True)


def _caches(parent: Path, stamps: Sequence[str]) -> list[StoredColumns]:
    """The sound caches in a folder that hold some of the materials."""
    wanted, found = set(stamps), []
    for path in sorted(parent.glob("[!.]*/manifest.json")):
        with suppress(OSError, ValueError, SafetensorError):
            manifest = _manifest(path.parent)
            if manifest is not None and wanted.intersection(manifest.get("stamps", [])):
                found.append(_open(path.parent))
    return found


def build_in_memory(source: ColumnSource, known: Sequence[StoredColumns] = ()) -> StoredColumns:
    """The same columns without a file, for a few tables."""
    columns = torch.empty(N_CELLS, 3 * len(source.names), dtype=torch.float16)

    def write(i: int, rows: Tensor) -> None:
        columns[i * ROW_CELLS : (i + 1) * ROW_CELLS] = rows

    stamps = source.stamps if known else ()
    build = _Build(source, stamps, known)
    build.convert(write, progress=False)
    _fill(columns, build.valid, build.fresh)
    fingerprint = _fingerprint(source.names, build.scale, columns)
    return StoredColumns(
        source.names, columns, build.scale, build.gram, build.valid, fingerprint, stamps=stamps,
        parts=build.parts(columns),
    )  # fmt: skip


def _manifest(folder: Path) -> dict[str, Any] | None:
    """Of a cache of this version that is whole; None else."""
    try:
        manifest = json.loads((folder / "manifest.json").read_text())
        size = (folder / "columns.f16").stat().st_size
        with safe_open(folder / "library.safetensors", "pt") as tensors:
            sound = set(tensors.keys()) == {"scale", "gram", "valid"}
            peak = float(tensors.get_tensor("scale").max()) * 2**_TARGET_EXPONENT
    except (OSError, ValueError, SafetensorError):
        return None
    sound = sound and peak <= LARGEST and isinstance(manifest, dict) and manifest.get("format") == FORMAT
    return manifest if sound and size == 2 * N_CELLS * 3 * len(manifest["names"]) else None


def _is_current(folder: Path, stamp: str) -> bool:
    manifest = _manifest(folder)
    return manifest is not None and manifest.get("stamp") == stamp


def _open(folder: Path) -> StoredColumns:
    manifest = json.loads((folder / "manifest.json").read_text())
    names = tuple(manifest["names"])
    mapping, columns = _map(folder / "columns.f16", mmap.ACCESS_COPY, len(names))
    tensors = load_file(folder / "library.safetensors")
    return StoredColumns(
        names, columns, **tensors, fingerprint=manifest["fingerprint"], mapping=mapping,
        stamps=tuple(manifest.get("stamps", [])),
        parts=tuple(Part(key, tuple(theirs), tuple(mine)) for key, theirs, mine in manifest.get("parts", [])),
    )  # fmt: skip


def _map(path: Path, access: int, n_materials: int) -> tuple[mmap.mmap, Tensor]:
    """The columns in a file: ACCESS_WRITE changes the file, ACCESS_COPY only reads it."""
    with open(path, "rb" if access == mmap.ACCESS_COPY else "r+b") as file:
        mapping = mmap.mmap(file.fileno(), 0, access=access)
    return mapping, torch.frombuffer(mapping, dtype=torch.float16).view(N_CELLS, 3 * n_materials)


def _build_folder(
    source: ColumnSource, stamps: tuple[str, ...], folder: Path, progress: bool, known: Sequence[StoredColumns]
) -> None:
    stamp = source.stamp
    check_room(folder.parent, 1.05 * 2 * N_CELLS * 3 * len(source.names), "the library cache")
    with replacing_folder(folder, OTHER_DISK) as temporary:
        build = _Build(source, stamps, known)
        with open(temporary / "columns.f16", "wb") as file, ThreadPoolExecutor(1) as writer:
            written: list[Future[None]] = []

            def write(_: int, rows: Tensor) -> None:
                """While the next row is computed."""
                for earlier in written:
                    earlier.result()
                written[:] = [writer.submit(rows.numpy().tofile, file)]

            build.convert(write, progress)
            written[0].result()
        mapping, columns = _map(temporary / "columns.f16", mmap.ACCESS_WRITE, len(source.names))
        _fill(columns, build.valid, build.fresh, mapping)
        tensors = {"scale": build.scale, "gram": build.gram, "valid": build.valid}
        save_file(tensors, temporary / "library.safetensors")
        manifest = {
            "format": FORMAT,
            "stamp": stamp,
            "stamps": stamps,
            "names": source.names,
            "fingerprint": _fingerprint(source.names, build.scale, columns, mapping),
            "parts": [(part.fingerprint, part.theirs, part.mine) for part in build.parts(columns, mapping)],
        }
        (temporary / "manifest.json").write_text(json.dumps(manifest))


class _Build:
    """The columns of a source, a theta_h row at a time; what earlier libraries hold is taken from them.

    scale (n,), gram (n, n), valid (m, N_CELLS / 8)  as in `StoredColumns`, after `convert`
    """

    scale: Tensor
    gram: Tensor
    valid: Tensor

    def __init__(self, source: ColumnSource, stamps: Sequence[str], known: Sequence[StoredColumns]) -> None:
        self.names = source.names
        self.reused, self.fresh = reusable(stamps, known) if known else ([], list(range(len(source.names))))
        self.source = source if len(self.fresh) == len(source.names) else source.subset(self.fresh)

    def convert(self, write: Callable[[int, Tensor], None], progress: bool) -> None:
        """Write every row of the columns as float16; those of new materials are not yet filled."""
        m = len(self.names)
        with tqdm(total=len(self.fresh) + GRID[0], desc="material library", disable=not progress, leave=False) as bar:
            self.scale = torch.ones(3 * m, dtype=torch.float64)
            self.valid = torch.empty(m, N_CELLS // 8, dtype=torch.uint8)
            for part in self.reused:
                self.scale[columns_of(part.mine)] = part.stored.scale.cpu()[columns_of(part.theirs)]
                self.valid[list(part.mine)] = part.stored.valid[list(part.theirs)]
            for i, material in enumerate(self.fresh):
                peak, measured = self.source.scan(i)
                self.valid[material] = torch.from_numpy(np.packbits(measured.numpy()))
                self.scale[3 * material : 3 * material + 3] = _scale_of(peak.double())
                bar.update()
            everywhere = shared_cells(self.valid)
            total = GramSum(3 * m, everywhere, self.reused)
            for i in range(GRID[0]):
                rows, halves = self._row(i)
                total.add(slice(i * ROW_CELLS, (i + 1) * ROW_CELLS), rows)
                write(i, halves)
                bar.update()
        if not total.exact:
            total = GramSum(3 * m, everywhere, [])
            for i in range(GRID[0]):
                total.add(slice(i * ROW_CELLS, (i + 1) * ROW_CELLS), self._row(i)[0])
        self.gram = total.total()

    def _row(self, i: int) -> tuple[Tensor, Tensor]:
        """Row i of all columns: f_r, and f_r / scale as float16, whose rounding f_r has where it was stored so."""
        fresh = self.source.row(i) if self.fresh else torch.empty(ROW_CELLS, 0)
        which = columns_of(self.fresh)
        ready = (fresh / self.scale[which].to(fresh.dtype)).half()  # exact but for the last step: of a power of two
        if not self.reused:
            return fresh, ready
        halves = torch.empty(ROW_CELLS, 3 * len(self.names), dtype=torch.float16)
        halves[:, which] = ready
        for part in self.reused:
            stored = part.stored.columns[i * ROW_CELLS : (i + 1) * ROW_CELLS]
            halves[:, _run(part.mine)] = stored[:, _run(part.theirs)].cpu()
            part.stored.release()
        rows = halves.double().mul_(self.scale)
        rows[:, which] = fresh.double()
        return rows, halves

    def parts(self, columns: Tensor, mapping: mmap.mmap | None = None) -> tuple[Part, ...]:
        """The libraries that were used, and what is new as one of its own."""
        parts = [part for reused in self.reused for part in reused.parts]
        if self.reused and self.fresh:
            which = columns_of(self.fresh)
            names = tuple(self.names[i] for i in self.fresh)
            key = _fingerprint(names, self.scale[which], columns, mapping, which)
            parts.append(Part(key, tuple(range(len(self.fresh))), tuple(self.fresh)))
        return tuple(parts)


def _fill(columns: Tensor, valid: Tensor, materials: Sequence[int], mapping: mmap.mmap | None = None) -> None:
    """Give unmeasured cells of some materials the value of their nearest measured neighbour, in place."""
    alike: dict[bytes, list[int]] = {}
    for material in materials:
        alike.setdefault(valid[material].numpy().tobytes(), []).append(material)
    for some in alike.values():
        measured = shared_cells(valid[some[:1]])
        holes = torch.nonzero(~measured).ravel()
        source, which = nearest_measured(measured)[holes], columns_of(some)
        for cells, nearest in zip(holes.split(ROW_CELLS), source.split(ROW_CELLS), strict=True):
            if len(which) == columns.shape[1]:
                columns[cells] = columns[nearest]
            else:
                columns[cells[:, None], which] = columns[nearest[:, None], which]
            _release(mapping)


def _run(materials: Sequence[int]) -> Tensor | slice:
    """The columns of materials: as a slice where they follow each other, which is copied ten times as fast."""
    first, last = materials[0], materials[-1]
    return slice(3 * first, 3 * last + 3) if list(materials) == list(range(first, last + 1)) else columns_of(materials)


def _scale_of(peak: Tensor) -> Tensor:
    return torch.exp2(torch.floor(torch.log2(torch.where(peak > 0, peak, 1.0))) - _TARGET_EXPONENT)


def _release(mapping: mmap.mmap | None) -> None:
    if mapping is not None and hasattr(mmap, "MADV_DONTNEED"):
        mapping.madvise(mmap.MADV_DONTNEED)


def _fingerprint(
    names: tuple[str, ...],
    scale: Tensor,
    columns: Tensor,
    mapping: mmap.mmap | None = None,
    which: Tensor | None = None,
) -> str:
    digest = hashlib.sha256(repr(names).encode() + scale.numpy().tobytes())
    for start in range(0, N_CELLS, ROW_CELLS):
        rows = columns[start : start + ROW_CELLS]
        digest.update((rows if which is None else rows[:, which]).numpy().tobytes())
        _release(mapping)
    return digest.hexdigest()
