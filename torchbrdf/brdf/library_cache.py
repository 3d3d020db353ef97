"""The memory-mapped, cell-major cache of a library: one row a cell, one float16 column a basis BRDF.

A column is stored divided by a power of two that puts its largest value near 2^11: then float16 has 11
significant bits (relative error at most 2^-11 = 4.9e-4) down to 2^-25 of the peak. A cache folder is built under a
lock in a temporary folder and renamed, so what carries the final name is finished.
"""

import copyreg
import json
import mmap
import shutil
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from torchbrdf.brdf._library_building import TARGET_EXPONENT, Build, reader, remarks, same_in
from torchbrdf.brdf.column_sources import ColumnSource
from torchbrdf.brdf.merl import LARGEST
from torchbrdf.brdf.merl_grid import N_CELLS
from torchbrdf.brdf.stored_columns import Part, StoredColumns
from torchbrdf.files import OTHER_DISK, check_room, replacing_folder, writing
from torchbrdf.progress import announce

FORMAT = 1
MIXTURE = "mixture-"
"""How the folders begin of libraries of several folders or files."""

_SECONDS = 0.1
"""To convert a material, about."""

_LONG = 5.0
"""Seconds of which is said beforehand that they will pass."""

_KEPT_MIXTURES = 8
"""The last ones that were opened: each change of what is mixed makes another, of 9 MB a material."""


def open_or_build(
    source: ColumnSource, folder: Path, progress: bool, known: Sequence[StoredColumns] | None = ()
) -> StoredColumns:
    """The cache in `folder`, built first where it is absent, damaged or older than its sources.

    known  libraries whose columns are taken before those that other caches beside `folder` hold; None to take none,
           so that the Gram matrix is the same to the bit whatever was opened before
    Raises OSError where the disk has no room; ValueError where a source changes while it is read.
    """
    from filelock import FileLock

    folder.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(_lock_of(folder)):
        stamps = source.stamps
        manifest = _manifest(folder)
        if manifest is None or manifest.get("stamp") != source.stamp:
            _remove_leftovers(folder)
            held = [] if known is None else [*known, *_caches(folder, stamps)]
            try:
                _build_folder(source, stamps, folder, progress, held)
            except (OSError, ValueError):
                with suppress(OSError):
                    _lock_of(folder).unlink()
                raise
            _clear(folder)
        elif "said" not in manifest:
            _complete(folder, manifest, stamps)
        with suppress(OSError):
            (folder / "manifest.json").touch()
        return _open(folder)


def _lock_of(folder: Path) -> Path:
    return folder.with_suffix(".lock")


def _remove_leftovers(folder: Path) -> None:
    """Of builds of this folder that were killed."""
    for leftover in folder.parent.glob(f".{folder.name}.*"):
        shutil.rmtree(leftover, ignore_errors=True)


def _clear(built: Path) -> None:
    """Remove the mixtures that were opened longest ago, but for `_KEPT_MIXTURES`, and what is left of killed builds.

    None that is being built.
    """
    from filelock import FileLock, Timeout

    manifests = [path for path in built.parent.glob(f"{MIXTURE}*/manifest.json") if path.parent != built]
    unfinished = {path.name[1:].split(".")[0] for path in built.parent.glob(f".{MIXTURE}*")}
    with suppress(OSError):
        newest_first = sorted(manifests, key=lambda path: path.stat().st_mtime, reverse=True)
        obsolete = {path.parent.name for path in newest_first[_KEPT_MIXTURES - 1 :]}
        for folder in (built.with_name(name) for name in obsolete | unfinished - {built.name}):
            with suppress(Timeout), FileLock(_lock_of(folder), timeout=0):
                _remove_leftovers(folder)
                if folder.name in obsolete:
                    shutil.rmtree(folder, ignore_errors=True)


def _caches(folder: Path, stamps: Sequence[str]) -> list[StoredColumns]:
    """The sound caches beside a folder, whose lock is held, and in it, that hold some of the materials.

    One that another process builds is left out.
    """
    from filelock import FileLock, Timeout

    wanted, found = set(stamps), []
    for other in sorted(path.parent for path in folder.parent.glob("[!.]*/manifest.json")):
        lock = nullcontext() if other == folder else FileLock(_lock_of(other), timeout=0)
        with suppress(OSError, ValueError, SafetensorError, Timeout), lock:
            manifest = _manifest(other)
            if manifest is not None and "said" in manifest and wanted.intersection(manifest["stamps"]):
                found.append(_open(other))
    return found


def _manifest(folder: Path) -> dict[str, Any] | None:
    """Of a cache of this version that is whole; None else."""
    try:
        manifest = json.loads((folder / "manifest.json").read_text())
        size = (folder / "columns.f16").stat().st_size
        with safe_open(folder / "library.safetensors", "pt") as tensors:
            sound = set(tensors.keys()) == {"scale", "gram", "valid"}
            sound = sound and bool(tensors.get_tensor("gram").any())  # 0.10: no common cell
            peak = float(tensors.get_tensor("scale").max()) * 2**TARGET_EXPONENT
    except (OSError, ValueError, SafetensorError):
        return None
    sound = sound and peak <= LARGEST and isinstance(manifest, dict) and manifest.get("format") == FORMAT
    return manifest if sound and size == 2 * N_CELLS * 3 * len(manifest["names"]) else None


def _pickled(stored: StoredColumns) -> str | tuple[Any, ...]:
    """In a pickle: where what is mapped lies, and which library that is; what is in memory as it is."""
    if stored.mapping is None or stored.folder is None:
        return stored.__reduce_ex__(2)
    return _reopened, (stored.folder, stored.fingerprint)


def _reopened(folder: Path, fingerprint: str) -> StoredColumns:
    """What a pickle of a mapped library stands for; ValueError where its cache is gone or holds another library."""
    manifest = _manifest(folder)
    if manifest is None or manifest["fingerprint"] != fingerprint:
        why = "is gone" if manifest is None else "holds another library by now"
        raise ValueError(f"{folder}: the cache of a pickled library {why}; open the library anew, and pickle it again")
    return _open(folder)


copyreg.pickle(StoredColumns, _pickled)


def _open(folder: Path) -> StoredColumns:
    manifest = json.loads((folder / "manifest.json").read_text())
    names = tuple(manifest["names"])
    mapping, columns = _map(folder / "columns.f16", mmap.ACCESS_COPY, len(names))
    tensors = load_file(folder / "library.safetensors")
    return StoredColumns(
        names, columns, **tensors, fingerprint=manifest["fingerprint"], mapping=mapping,
        stamps=tuple(manifest.get("stamps", ())),
        said=tuple(map(tuple, manifest.get("said", ()))),
        same=tuple((i, j) for i, j in manifest.get("same", ())),
        parts=tuple(Part(key, tuple(theirs), tuple(mine)) for key, theirs, mine in manifest.get("parts", ())),
        folder=folder.absolute(),
    )  # fmt: skip


def _map(path: Path, access: int, n_materials: int) -> tuple[mmap.mmap, Tensor]:
    """The columns in a file: ACCESS_WRITE changes the file, ACCESS_COPY only reads it."""
    with open(path, "rb" if access == mmap.ACCESS_COPY else "r+b") as file:
        mapping = mmap.mmap(file.fileno(), 0, access=access)
    return mapping, torch.frombuffer(mapping, dtype=torch.float16).view(N_CELLS, 3 * n_materials)


def _complete(folder: Path, manifest: dict[str, Any], stamps: tuple[str, ...]) -> None:
    """Add what caches of before 0.11 do not say."""
    stored = _open(folder)
    rows = reader(stored.columns, stored.mapping)
    added = {
        "stamps": stamps,
        "said": remarks(rows, stored.scale, stored.valid, range(len(stored.names))),
        "same": same_in(rows, stored.scale, stored.valid),
        "parts": [],
    }
    with writing(folder / "manifest.json", OTHER_DISK) as temporary:
        temporary.write_text(json.dumps(manifest | added))


def _build_folder(
    source: ColumnSource, stamps: tuple[str, ...], folder: Path, progress: bool, known: Sequence[StoredColumns]
) -> None:
    stamp, size = source.stamp, 2 * N_CELLS * 3 * len(source.names)
    check_room(folder.parent, 1.05 * size, "the library cache")
    with replacing_folder(folder, OTHER_DISK) as temporary:
        build = Build(source, stamps, known)
        seconds = _SECONDS * len(build.fresh)
        announce(
            f"library of {len(source.names)} materials: converted once, which takes about {seconds:.0f} s, and kept, "
            f"{size / 1e9:.1f} GB, in {folder}",
            shown=progress and seconds >= _LONG,
        )
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
        stored = build.finished(columns, mapping)
        if source.stamps != stamps:
            raise ValueError("a file of the library changed while it was read; run this again when it is whole")
        tensors = {"scale": stored.scale, "gram": stored.gram, "valid": stored.valid}
        save_file(tensors, temporary / "library.safetensors")
        manifest = {
            "format": FORMAT,
            "stamp": stamp,
            "stamps": stamps,
            "names": source.names,
            "fingerprint": stored.fingerprint,
            "said": stored.said,
            "same": stored.same,
            "parts": [(part.fingerprint, part.theirs, part.mine) for part in stored.parts],
        }
        (temporary / "manifest.json").write_text(json.dumps(manifest))
