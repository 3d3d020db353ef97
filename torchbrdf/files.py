"""Inputs that are there, and outputs that are whole or absent: written under a temporary name, then renamed."""

import errno
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_STAND_INS = (
    (
        re.compile(rb"version https?://git-lfs\.github\.com/spec/"),
        "a Git LFS pointer; `git lfs pull` in its repository fetches the file itself",
    ),
    (re.compile(rb"/annex/objects/"), "a git-annex pointer; `git annex get` fetches the file itself"),
    (
        re.compile(rb"\x00\x05\x16\x07"),
        "what macOS notes about a file (AppleDouble), not the file itself; name the one without ._",
    ),
    (
        re.compile(
            rb"(?:\xef\xbb\xbf)?\s*+(?:(?><\?xml.*?>|<!--.*?-->)\s*+)*+<(?:!doctype html|html|head|error>)", re.I | re.S
        ),
        "a web page, as downloads that failed leave; download it again",
    ),
)
"""How files begin that lie in the place of another, and what they are."""

_BEGINNING_BYTES = 1024


def existing_file(path: str | os.PathLike[str], what: str) -> Path:
    """The path of a file that can be read and is not empty, nor something that stands in for the file.

    what  was expected, such as "a MERL .binary table"
    Raises FileNotFoundError, IsADirectoryError, PermissionError, or ValueError (empty, a pipe, a Git LFS pointer, a web
    page in its place) with one line that names the file and says what to do.
    """
    path = Path(path)
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(f"{path}: is a folder; expected {what}")
        if not stat.S_ISREG(mode):
            raise ValueError(f"{path}: is a pipe or a device; expected {what} in a file: write it to one first")
        with open(path, "rb") as file:
            beginning = file.read(_BEGINNING_BYTES)
    except PermissionError:
        raise PermissionError(f"{path}: no permission to read it; change that (chmod), or name a copy") from None
    except (FileNotFoundError, NotADirectoryError):
        raise FileNotFoundError(f"{path}: {_absence(path)}; expected {what}") from None
    if not beginning:
        raise ValueError(f"{path}: is empty (0 bytes); expected {what}: copy or download it again")
    for pattern, kind in _STAND_INS:
        if pattern.match(beginning):
            raise ValueError(f"{path}: is {kind}")
    return path


def _absence(path: Path) -> str:
    if not path.is_symlink():
        return "no such file"
    target = os.readlink(path)
    if "annex/objects" in Path(target).as_posix():
        return "a git-annex link to a file that is not here, which `git annex get` fetches"
    return f"a link to {target}, which does not exist"


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
