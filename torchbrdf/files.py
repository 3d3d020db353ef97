"""Outputs that are whole or absent: written under a temporary name, then renamed."""

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path beside `path`, with its suffix, that replaces `path` when the block ends without an error.

    Where the block raises, or is interrupted, the temporary file is removed and `path` stays as it was.
    """
    path = Path(path)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
    except OSError as error:
        raise _unwritable(error, path) from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        mask = os.umask(0)
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


@contextmanager
def writing_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary folder beside `path` whose files move into `path` when the block ends without an error."""
    path = Path(path)
    anchor = path.parent
    while not anchor.exists():
        anchor = anchor.parent
    try:
        if path.exists() and not path.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        if path.exists() and not os.access(path, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=anchor))
    except OSError as error:
        raise _unwritable(error, path) from None
    try:
        yield temporary
        path.mkdir(parents=True, exist_ok=True)
        for file in temporary.iterdir():
            os.replace(file, path / file.name)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _unwritable(error: OSError, path: Path) -> OSError:
    return type(error)(error.errno, f"cannot write here ({error.strerror}); choose another folder", str(path))


def check_room(folder: Path, size: float, what: str, otherwise: str = "") -> None:
    """Raises OSError where the disk of a cache folder has no room for `size` bytes.

    otherwise  what one can do beside making room, as the end of the message
    """
    free = shutil.disk_usage(folder).free
    if free < size:
        raise OSError(
            f"{folder}: {what} needs {size / 1e9:.2f} GB, {free / 1e9:.2f} GB are free; make room or set "
            f"TORCHBRDF_CACHE to another disk{otherwise}"
        )


def cache_folder() -> Path:
    """Where caches live: $TORCHBRDF_CACHE, else the user's cache folder of this system."""
    from platformdirs import user_cache_path

    chosen = os.environ.get("TORCHBRDF_CACHE")
    return Path(chosen).expanduser() if chosen else user_cache_path("torchbrdf")
