"""The precomputed transport of a library on disk: one file of kernels, memory-mapped, for each library's content.

A file is named after the fingerprint of the library's columns and after what the kernels depend on beside them, so a
library that changes gets another file; one that grew from libraries whose files are there has but what came new
computed, as a file of its own. Groups of rings are kept one by one while they are computed: what was
interrupted resumes. A checksum tells a damaged file, which is computed again.
"""

import hashlib
import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from itertools import accumulate, islice
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from torchbrdf.brdf import MaterialLibrary, Part, StoredColumns, column_norms, columns_of, norm_settings
from torchbrdf.files import OTHER_DISK, cache_folder, check_room, writing
from torchbrdf.lasting import LastFew, lasting
from torchbrdf.progress import announce, progress_bar
from torchbrdf.transport.harmonic._compression import compute_group, kernel_settings, perspective_settings
from torchbrdf.transport.harmonic._kernels import Band, Kernels
from torchbrdf.transport.harmonic._pages import mapped_values
from torchbrdf.transport.harmonic.grid import settings, zones
from torchbrdf.transport.harmonic.transport import HarmonicTransport

_FORMAT = "torchbrdf harmonic transport 2"
_HEADROOM = 600e6
"""Bytes that a build may take on disk."""

_MOST_PARTS = 4
"""Of a library that grew, whose kernels are kept apart: each costs some time with every probe."""

_SUMMED = 512
"""Values of a block of the checksum, two in a word."""

_in_memory: LastFew[str, HarmonicTransport] = LastFew(4)
_norms: LastFew[str, Tensor] = LastFew(1)


@lasting
def transport_of(library: MaterialLibrary, progress: bool = False, perspective: bool = False) -> HarmonicTransport:
    """The harmonic transport of all stored columns of a library, computed on first use: half a minute for 300.

    perspective  with what it adds to the views of balls, which takes another
    Libraries that live in the cache keep theirs beside it; those of tables in memory only as long as the process.
    Raises OSError where the disk has no room for it.
    """
    stored, device = library.stored, library.stored.columns.device

    def opened() -> HarmonicTransport:
        kernels = tuple(group.to(device) for group in _kernels_of(stored, perspective, progress))
        return replace(transport_of(library, progress), added=kernels) if perspective else HarmonicTransport(kernels)

    return _in_memory.get_or_make(f"{_path(stored, perspective).stem} {device}", opened)


def is_precomputed(library: MaterialLibrary, perspective: bool = False) -> bool:
    """Whether `transport_of` would only read files."""
    stored = library.stored
    ready = [_path(stored, part).is_file() or not _missing(stored, part)[1] for part in {False, perspective}]
    return all(ready)


def files_of(library: MaterialLibrary, perspective: bool = False) -> list[Path]:
    """The files that `transport_of` reads, those that are there: of a library that grew, its parts' and its own."""
    stored, found = library.stored, []
    for part in sorted({False, perspective}):
        own = _path(stored, part)
        held, missing = ([], []) if own.is_file() else _missing(stored, part)
        found += [own, *(_path_of(one.fingerprint, part) for one in held)]
        found += [_path(stored.of(missing), part)] if held and missing else []
    return [path for path in found if path.is_file()]


def _kernels_of(stored: StoredColumns, perspective: bool, progress: bool) -> tuple[Kernels, ...]:
    """Of all columns together; of a library that grew from others, theirs, and of what came new by itself."""
    if _path(stored, perspective).is_file():
        return _from_disk(stored, perspective, progress)
    held, missing = _missing(stored, perspective)
    if not held:
        if stored.mapping is not None:
            return _from_disk(stored, perspective, progress)
        return _assembled(stored, perspective, None, progress)
    kernels = [(part, _read(_path_of(part.fingerprint, perspective))) for part in held]
    if any(groups is None for _, groups in kernels):
        return _from_disk(stored, perspective, progress)
    if missing:
        own = Part("", tuple(range(len(missing))), tuple(missing))
        kernels.append((own, _from_disk(stored.of(missing), perspective, progress)))
    n = stored.columns.shape[1]
    return tuple(_placed(group, part, n) for part, groups in kernels for group in groups or ())


def _missing(stored: StoredColumns, perspective: bool) -> tuple[list[Part], list[int]]:
    """Parts of a library whose kernels are on disk, and the materials of none; no parts where too little is there."""
    held = [part for part in stored.parts if _path_of(part.fingerprint, perspective).is_file()]
    missing = sorted(set(range(len(stored.names))).difference(*(part.mine for part in held)))
    if len(held) > _MOST_PARTS or 3 * len(missing) > len(stored.names):
        return [], list(range(len(stored.names)))
    return held, missing


def _placed(group: Kernels, part: Part, n: int) -> Kernels:
    """The kernels of a part as those of all n columns of the library that holds it."""
    mixing = group.mixing.new_zeros(n, group.mixing.shape[1])
    mixing[columns_of(part.mine)] = group.mixing[columns_of(part.theirs)]
    return replace(group, mixing=mixing)


def _path(stored: StoredColumns, perspective: bool = False) -> Path:
    return _path_of(stored.fingerprint, perspective)


def _path_of(fingerprint: str, perspective: bool) -> Path:
    """Of the kernels of an orthographic camera, or of what perspective adds."""
    depends = [_FORMAT, settings(), kernel_settings(), *(perspective_settings() if perspective else [])]
    key = hashlib.sha256((fingerprint + json.dumps(depends)).encode()).hexdigest()[:24]
    return cache_folder() / "harmonic" / f"{key}.safetensors"


def _from_disk(stored: StoredColumns, perspective: bool, progress: bool) -> tuple[Kernels, ...]:
    from filelock import FileLock

    path = _path(stored, perspective)
    path.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(path.with_suffix(".lock")):
        kernels = _read(path)
        if kernels is None:
            parts = path.with_suffix(".parts")
            check_room(path.parent, _HEADROOM, "the harmonic transport")
            parts.mkdir(exist_ok=True)
            announce(
                f"{_called(perspective)} of {len(stored.names)} materials: computed once for this library, which takes "
                f"half a minute or so where there are a hundred, and kept in {path.parent}",
                shown=progress,
            )
            try:
                built = _assembled(stored, perspective, parts, progress)
            except KeyboardInterrupt:
                message = "interrupted; the harmonic transport goes on from here when it is next asked for"
                raise KeyboardInterrupt(message) from None
            _write(path, built)
            shutil.rmtree(parts, ignore_errors=True)
            kernels = _read(path)
            if kernels is None:
                raise OSError(f"{path}: what was written reads back damaged; check the disk")
        return kernels


def _assembled(stored: StoredColumns, perspective: bool, parts: Path | None, progress: bool) -> tuple[Kernels, ...]:
    """Compute all groups, on the CPU; those already in a folder of parts are read."""
    stored = replace(stored, columns=stored.columns.cpu())
    groups: list[Kernels] = []
    orders = (1, 2) if perspective else (0,)
    everything = [(zone, rings) for zone in zones() for rings in zone.groups]
    norms = _norms.get_or_make(f"{stored.fingerprint} {norm_settings()}", lambda: column_norms(stored))
    for i, (zone, rings) in enumerate(progress_bar(everything, desc=_called(perspective), shown=progress)):
        part = None if parts is None else parts / f"{i}.safetensors"
        known = None if part is None else _read(part)
        if known is None:
            known = compute_group(stored, orders, zone, rings, norms, len(zones()))
            if part is not None:
                _write(part, known)
        groups.extend(known)
    return tuple(group for group in groups if group.mixing.shape[1])


def _called(perspective: bool) -> str:
    return "harmonic transport, perspective" if perspective else "harmonic transport"


def _tensors(groups: tuple[Kernels, ...]) -> Iterator[Tensor]:
    for group in groups:
        yield group.mixing
        for band in group.bands:
            yield from (band.even, band.odd, band.mix_even, band.mix_odd)


def _write(path: Path, groups: tuple[Kernels, ...]) -> None:
    layout = [
        {
            "order": group.order, "zone": group.zone, "first_ring": group.first_ring, "n_rings": group.n_rings,
            "places": group.places, "first_row": group.first_row, "bands": [band.low for band in group.bands],
        }
        for group in groups
    ]  # fmt: skip
    shapes = [list(tensor.shape) for tensor in _tensors(groups)]
    values = torch.cat([tensor.ravel() for tensor in _tensors(groups)])
    contents = json.dumps([layout, shapes])
    metadata = {"format": _FORMAT, "contents": contents, "checksum": _checksum(values, contents)}
    with writing(path, OTHER_DISK) as temporary:
        save_file({"values": values}, temporary, metadata)


def _read(path: Path) -> tuple[Kernels, ...] | None:
    """What `_write` wrote; None where there is no such file or a damaged one."""
    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
            (count,) = file.get_slice("values").get_shape()
        values, pages = mapped_values(path, count)
    except (OSError, ValueError, SafetensorError):
        return None
    contents = metadata.get("contents", "")
    if metadata.get("format") != _FORMAT or metadata.get("checksum") != _checksum(values, contents):
        return None
    layout, shapes = json.loads(contents)
    sizes = [int(torch.Size(shape).numel()) for shape in shapes]
    tensors = iter([part.view(shape) for part, shape in zip(values.split(sizes), shapes, strict=True)])
    groups, ends = [], iter([0, *accumulate(4 * size for size in sizes)])
    end = next(ends)
    for entry in layout:
        start, end = end, next(islice(ends, 4 * len(entry["bands"]), None))
        groups.append(
            Kernels(
                order=entry.get("order", 0), zone=entry["zone"], first_ring=entry["first_ring"],
                n_rings=entry["n_rings"], places=entry["places"], first_row=entry["first_row"], mixing=next(tensors),
                bands=tuple(Band(low, *islice(tensors, 4)) for low in entry["bands"]),
                pages=replace(pages, start=pages.start + start, end=pages.start + end),
            )
        )  # fmt: skip
    return tuple(groups)


def _checksum(values: Tensor, contents: str) -> str:
    """Of the contents' text and of a sum over the words of every block of values: a hash of all takes too long."""
    whole = len(values) - len(values) % _SUMMED
    sums = values[:whole].view(torch.int64).view(-1, _SUMMED // 2).sum(1)  # modulo 2^64
    rest = values[whole:].view(torch.int32).long()
    return hashlib.sha256(contents.encode() + torch.cat([sums, rest]).numpy().tobytes()).hexdigest()
