"""Which photographs `torchbrdf fit` is given, what each is called, and under which probe it was taken."""

import argparse
import warnings
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from torchbrdf.brdf import RESULT
from torchbrdf.commands._options import inputs_of
from torchbrdf.commands._results import obsolete
from torchbrdf.commands._weights import WEIGHTS
from torchbrdf.images import readable_suffixes

_OF_FEW_BITS = (".png", ".jpg", ".jpeg")


@dataclass(frozen=True)
class Photograph:
    """One of the files, and what of the options is its own.

    name   of its results
    probe  as `--probe` takes it
    """

    path: Path
    name: str
    probe: str

    def its(self, options: argparse.Namespace) -> argparse.Namespace:
        """The options with this photograph and its probe."""
        return argparse.Namespace(**vars(options) | {"photo": self.path, "probe": self.probe})


def photographs(options: argparse.Namespace) -> list[Photograph]:
    """Those of `options.photos`, files and folders, in order; a folder's by name, less what other options name
    and what `fit` wrote there.

    Raises ValueError for a folder without photographs, for two that would have the same results, and where there are
    neither one `options.probes` nor as many as photographs; OSError for a folder that cannot be read.
    """
    paths = [path for given in options.photos for path in _files(given, options)]
    taken: dict[str, Path] = {}
    for path in paths:
        other = taken.setdefault(path.stem.casefold(), path)
        if other is not path:
            both = f"{path} is given twice" if other == path else f"{other} and {path} have the same name"
            raise ValueError(f"{both}, by which results are called: leave one out, rename it, or give it another -o")
    probes = list(options.probes)
    if len(probes) > 1 and any(given.is_dir() for given in options.photos):
        raise ValueError(f"--probe is given {len(probes)} times: name the photographs in the same order")
    if len(probes) not in (1, len(paths)):
        raise ValueError(f"--probe is given {len(probes)} times for {len(paths)} photographs: give one, or one each")
    probes *= len(paths) if len(probes) == 1 else 1
    return [Photograph(path, path.stem, probe) for path, probe in zip(paths, probes, strict=True)]


def _files(given: Path, options: argparse.Namespace) -> Iterator[Path]:
    if not given.is_dir():
        yield given
        return
    few_bits = () if options.allow_ldr or options.encoding else _OF_FEW_BITS
    known = [suffix for suffix in readable_suffixes() if suffix not in few_bits]
    named = [path for path in inputs_of(options, "photos") if path.is_file()]
    own = obsolete(given) if (given / WEIGHTS).is_file() else ()
    found = [
        path
        for path in sorted(given.iterdir())
        if path.suffix.lower() in known and not path.name.startswith(".") and path.is_file() and path.name not in own
        and not any(path.samefile(other) for other in named)
    ]  # fmt: skip
    inside = [path for path in sorted(given.iterdir()) if _holds_pictures(path, known)]
    if not found:
        deeper = f"; subfolders are not read: name them, {inside[0]} for one" if inside else ""
        kinds = ", ".join(known)
        raise ValueError(f"{given}: holds no photographs ({kinds}); those of 8 bits need --allow-ldr{deeper}")
    if inside:
        message = f"{given}: subfolders are not read, and {len(inside)} of them hold pictures; name {inside[0]}, too"
        warnings.warn(message, UserWarning, stacklevel=2)
    _warn_of_left_out(given, few_bits, {path.stem.casefold() for path in (*found, *named)})
    yield from found


def _holds_pictures(path: Path, suffixes: Collection[str]) -> bool:
    """Whether a path is a folder with pictures, and none that `fit` wrote."""
    try:
        names = [one.name for one in path.iterdir() if not path.name.startswith(".")] if path.is_dir() else []
    except OSError:
        return False
    pictures = [name for name in names if Path(name).suffix.lower() in suffixes and not name.startswith(".")]
    return bool(pictures) and RESULT not in names


def _warn_of_left_out(folder: Path, suffixes: Collection[str], known: Collection[str]) -> None:
    """Warn of pictures of few bits in a folder; not of those with a name that is known, as previews have."""
    left_out = [
        path.name
        for path in sorted(folder.iterdir())
        if path.suffix.lower() in suffixes and not path.name.startswith(".") and path.stem.casefold() not in known
    ]
    if left_out:
        message = (
            f"{folder}: left out as not linear HDR: {len(left_out)} of its pictures, of 8 or 16 bits, the first "
            f"{left_out[0]}; --allow-ldr takes them, too"
        )
        warnings.warn(message, UserWarning, stacklevel=2)
