"""The precomputed transport of a library on disk: one file of kernels, memory-mapped, for each library's content.

A file is named after the fingerprint of the library's columns and after what the kernels depend on beside them, so a
library that changes gets another file. Groups of rings are kept one by one while they are computed: what was
interrupted resumes. A sum over all bits tells a damaged file, which is computed again.
"""

import hashlib
import json
import shutil
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor
from tqdm import tqdm

from torchbrdf.files import cache_folder, writing
from torchbrdf.harmonic import HarmonicTransport
from torchbrdf.harmonic_grid import settings, zones
from torchbrdf.harmonic_kernels import Band, Kernels, column_norms, compute_group, kernel_settings
from torchbrdf.library import MaterialLibrary
from torchbrdf.library_cache import StoredColumns

_FORMAT = "torchbrdf harmonic transport 1"
_HEADROOM = 600e6
"""Bytes that a build may take on disk."""

_in_memory: dict[str, HarmonicTransport] = {}
_REMEMBERED = 2


def transport_of(library: MaterialLibrary, progress: bool = False) -> HarmonicTransport:
    """The harmonic transport of all stored columns of a library, computed on first use: under a minute for 300.

    Libraries that live in the cache keep theirs beside it; those of tables in memory only as long as the process.
    Raises OSError where the disk has no room for it.
    """
    stored = library.stored
    key = stored.fingerprint
    if key not in _in_memory:
        found = _from_disk(stored, progress) if stored.mapping is not None else _assembled(stored, None, progress)
        while len(_in_memory) >= _REMEMBERED:
            _in_memory.pop(next(iter(_in_memory)))
        _in_memory[key] = found
    device = stored.columns.device
    return _in_memory[key] if device.type == "cpu" else _in_memory[key].to(device)


def is_precomputed(library: MaterialLibrary) -> bool:
    """Whether `transport_of` would only read a file."""
    return library.stored.mapping is not None and _path(library.stored).is_file()


def _path(stored: StoredColumns) -> Path:
    depends = json.dumps([_FORMAT, settings(), kernel_settings()])
    key = hashlib.sha256((stored.fingerprint + depends).encode()).hexdigest()[:24]
    return cache_folder() / "harmonic" / f"{key}.safetensors"


def _from_disk(stored: StoredColumns, progress: bool) -> HarmonicTransport:
    from filelock import FileLock

    path = _path(stored)
    path.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(path.with_suffix(".lock")):
        kernels = _read(path)
        if kernels is None:
            parts = path.with_suffix(".parts")
            free = shutil.disk_usage(path.parent).free
            if free < _HEADROOM:
                raise OSError(
                    f"{path.parent}: the harmonic transport needs {_HEADROOM / 1e9:.1f} GB, {free / 1e9:.2f} GB are "
                    'free; make room, set TORCHBRDF_CACHE to another disk, or use backend="sampled"'
                )
            parts.mkdir(exist_ok=True)
            built = _assembled(stored, parts, progress)
            _write(path, built.groups)
            shutil.rmtree(parts, ignore_errors=True)
            kernels = _read(path)
            if kernels is None:
                raise OSError(f"{path}: what was written reads back damaged; check the disk")
        return HarmonicTransport(kernels)


def _assembled(stored: StoredColumns, parts: Path | None, progress: bool) -> HarmonicTransport:
    """Compute all groups; those already in a folder of parts are read."""
    groups: list[Kernels] = []
    everything = [(zone, rings) for zone in zones() for rings in zone.groups]
    norms = column_norms(stored)
    for i, (zone, rings) in enumerate(tqdm(everything, "harmonic transport", disable=not progress, leave=False)):
        part = None if parts is None else parts / f"{i}.safetensors"
        known = None if part is None else _read(part)
        if known is None:
            known = (compute_group(stored, zone, rings, norms, len(zones())),)
            if part is not None:
                _write(part, known)
        groups.extend(known)
    return HarmonicTransport(tuple(groups))


def _tensors(groups: tuple[Kernels, ...]) -> Iterator[Tensor]:
    for group in groups:
        yield group.mixing
        for band in group.bands:
            yield from (band.even, band.odd, band.mix_even, band.mix_odd)


def _write(path: Path, groups: tuple[Kernels, ...]) -> None:
    layout = [
        {
            "zone": group.zone, "first_ring": group.first_ring, "n_rings": group.n_rings, "places": group.places,
            "first_row": group.first_row, "bands": [band.low for band in group.bands],
        }
        for group in groups
    ]  # fmt: skip
    shapes = [list(tensor.shape) for tensor in _tensors(groups)]
    values = torch.cat([tensor.ravel() for tensor in _tensors(groups)])
    metadata = {
        "format": _FORMAT, "layout": json.dumps(layout), "shapes": json.dumps(shapes), "sum": str(_sum_of_bits(values))
    }  # fmt: skip
    with writing(path) as temporary:
        try:
            save_file({"values": values}, temporary, metadata)
        except SafetensorError as error:
            message = f"{path.parent}: cannot write the harmonic transport ({error}); make room on the disk"
            raise OSError(message) from None


def _read(path: Path) -> tuple[Kernels, ...] | None:
    """What `_write` wrote; None where there is no such file or a damaged one."""
    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
            if metadata.get("format") != _FORMAT:
                return None
            values = file.get_tensor("values")
    except (OSError, SafetensorError):
        return None
    if str(_sum_of_bits(values)) != metadata["sum"]:
        return None
    shapes = json.loads(metadata["shapes"])
    sizes = [int(torch.Size(shape).numel()) for shape in shapes]
    tensors = iter([part.view(shape) for part, shape in zip(values.split(sizes), shapes, strict=True)])
    return tuple(
        Kernels(
            zone=entry["zone"], first_ring=entry["first_ring"], n_rings=entry["n_rings"], places=entry["places"],
            first_row=entry["first_row"], mixing=next(tensors),
            bands=tuple(Band(low, *islice(tensors, 4)) for low in entry["bands"]),
        )
        for entry in json.loads(metadata["layout"])
    )  # fmt: skip


def _sum_of_bits(values: Tensor) -> int:
    return int(values.view(torch.int32).sum(dtype=torch.int64))
