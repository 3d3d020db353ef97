"""What of a batch is finished: results whose weights.json says that they were made from the same, in the same way."""

import argparse
import hashlib
import json
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from torchbrdf._version import __version__
from torchbrdf.brdf import RESULT
from torchbrdf.commands._said import Said, in_record
from torchbrdf.commands._weights import WEIGHTS
from torchbrdf.files import cache_folder

_LOCKS = "locks"
_NOT_OF_THE_RESULT = (
    "photos", "probes", "output", "strict", "overwrite", "same_material", "run", "library", "command", "quiet", "json",
)  # fmt: skip


def origin(options: argparse.Namespace, library: str) -> dict[str, Any]:
    """What results depend on, as JSON holds it: files by name, size and time, all options, the library's content.

    options  of one photograph
    library  fingerprint
    """
    given = {key: value for key, value in vars(options).items() if key not in _NOT_OF_THE_RESULT}
    return {"version": __version__, "library": library} | {key: _stamp(value) for key, value in given.items()}


def _stamp(value: Any) -> Any:
    if not isinstance(value, Path | str) or not Path(value).is_file():
        return str(value) if isinstance(value, Path) else value
    path = Path(value)
    buffers = sorted(path.parent.glob("*.bin")) if path.suffix.lower() == ".gltf" else []
    states = [(one.name, one.stat()) for one in (path, *buffers)]
    return [[name, state.st_size, state.st_mtime_ns] for name, state in states]


def record(made_from: dict[str, Any], folder: Path, said: Sequence[Said]) -> dict[str, Any]:
    """What goes to weights.json of what else is in its folder, and of what was said."""
    files = {path.name: path.stat().st_size for path in sorted(folder.iterdir())}
    return {"made_from": made_from, "files": files, **in_record(said)}


def said_before(folder: Path, made_from: dict[str, Any]) -> list[Said] | None:
    """What was said of finished results; None where there are none, some are gone, or they are of something else."""
    try:
        known = json.loads((folder / WEIGHTS).read_text())
        files = known["files"]
        said = [Said(text, key == "notes") for key in ("warnings", "notes") for text in known[key]]
        whole = RESULT in files and all((folder / name).stat().st_size == size for name, size in files.items())
        same = known["made_from"] == json.loads(json.dumps(made_from))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    return said if whole and same and all(isinstance(one.text, str) for one in said) else None


def lock_of(folder: Path) -> AbstractContextManager[object]:
    """Held by one process of this machine at a time, for what it moves into a folder."""
    from filelock import FileLock

    locks = cache_folder() / _LOCKS
    locks.mkdir(parents=True, exist_ok=True)
    return FileLock(locks / f"{hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:24]}.lock")
