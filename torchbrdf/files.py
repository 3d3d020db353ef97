"""Outputs that are whole or absent: written under a temporary name, then renamed."""

import os
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
        raise type(error)(error.errno, f"cannot write here ({error.strerror}); choose another folder", str(path)) from None
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


def cache_folder() -> Path:
    """Where caches live: $TORCHBRDF_CACHE, else the user's cache folder of this system."""
    from platformdirs import user_cache_path

    chosen = os.environ.get("TORCHBRDF_CACHE")
    return Path(chosen).expanduser() if chosen else user_cache_path("torchbrdf")
