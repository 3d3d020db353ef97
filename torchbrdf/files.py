"""Inputs that are there, and outputs that are whole or absent: written under a temporary name, then renamed."""

import errno
import os
import re
import secrets
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path

from torchbrdf.interruption import uninterrupted

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
_FULL_DISK = re.compile(r"no space left|not enough (free )?space|disk quota", re.I)
_PRACTICALLY_NOTHING = 1 << 16
"""Bytes left where a write that did not say why it failed failed for want of room."""

OTHER_DISK = "set TORCHBRDF_CACHE to another disk"
"""What one can do where the disk of the caches is full."""

_SAME_STEM = 0.75
"""Share of letters in common, of names without their suffix, from which one may be the other misspelt."""

_FEW = 3
"""Names that are suggested, at most."""

_SYLLABLE = 3
"""Fewer letters are in too many names to tell which was meant."""

_being_written: set[Path] = set()


def printable(text: str) -> str:
    """One line, for messages that repeat what a file holds: characters that do not print as Python escapes them."""
    return text if text.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


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
        return f"no such file{_misspelt(path)}"
    target = os.readlink(path)
    if "annex/objects" in Path(target).as_posix():
        return "a git-annex link to a file that is not here, which `git annex get` fetches"
    return f"a link to {target}, which does not exist"


def _misspelt(path: Path) -> str:
    """As `did_you_mean`, of the files and folders beside a path with almost its name, whatever their suffix."""
    from difflib import get_close_matches

    try:
        beside = [name for name in sorted(os.listdir(path.parent)) if not name.startswith(".")]
    except OSError:
        return ""
    stems = {Path(name).stem.casefold() for name in beside}
    close = get_close_matches(path.stem.casefold(), stems, n=max(1, len(stems)), cutoff=_SAME_STEM)
    return did_you_mean(path.name, [name for name in beside if Path(name).stem.casefold() in close])


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """The end of a message about a word that is none of those known; empty where none is near.

    Names of which it is one of the words, up to three of them; else the shortest that holds it; else the nearest by its
    letters.
    """
    from difflib import get_close_matches

    by_letters = {name.strip("-").casefold(): name for name in known}
    letters = word.strip("-").casefold()
    holding = sorted((one for one in by_letters if len(letters) >= _SYLLABLE and letters in one), key=len)
    whole = [one for one in holding if letters in re.split(r"[\W_]+", one)]
    close = whole[:_FEW] or holding[:1] or get_close_matches(letters, by_letters, n=1)
    return f" (did you mean {' or '.join(by_letters[one] for one in close)}?)" if close else ""


class FullDiskError(OSError):
    """A file cannot be written: its disk is full, or the user's quota of it."""


@contextmanager
def writing(path: str | os.PathLike[str], otherwise: str = "choose another folder") -> Iterator[Path]:
    """A temporary path beside `path`, with its suffix, that replaces `path` when the block ends without an error.

    otherwise  what one can do beside making room where the disk is full, as the end of the message
    Where the block raises, or is interrupted, the temporary file is removed and `path` stays as it was.
    """
    path = Path(path)
    with _unfinished(path.parent, path.stem, path.suffix) as temporary, _naming_the_disk(path, temporary, otherwise):
        try:
            os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        except OSError as error:
            raise _unwritable(error, path) from None
        yield temporary
        os.replace(temporary, path)


@contextmanager
def writing_folder(
    path: str | os.PathLike[str],
    last: str | None = None,
    obsolete: Iterable[str] = (),
    lock: AbstractContextManager[object] | None = None,
) -> Iterator[Path]:
    """A temporary folder beside `path` whose files move into `path` when the block ends without an error.

    last      the file that tells that the others are whole: an old one goes first, the new one moves last
    obsolete  files of `path` that do not belong beside the new ones, and go where they are not written anew
    lock      held while files move
    """
    path = Path(path)
    anchor = path.parent
    while not anchor.exists():
        anchor = anchor.parent
    with _unfinished(anchor, path.name) as temporary, _naming_the_disk(path, temporary):
        try:
            if path.exists() and not path.is_dir():
                raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
            if path.exists() and not os.access(path, os.W_OK | os.X_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            temporary.mkdir()
        except OSError as error:
            raise _unwritable(error, path) from None
        yield temporary
        with lock or nullcontext(), uninterrupted():
            path.mkdir(parents=True, exist_ok=True)
            written = sorted(os.listdir(temporary), key=lambda name: (name == last, name))
            old = [name for name in (last, *obsolete) if name is not None and (name == last or name not in written)]
            for name in old:
                (path / name).unlink(missing_ok=True)
            for name in written:
                os.replace(temporary / name, path / name)


@contextmanager
def replacing_folder(path: Path, otherwise: str) -> Iterator[Path]:
    """A temporary folder beside `path` that takes its place as a whole; see `writing`."""
    with _unfinished(path.parent, path.name) as temporary, _naming_the_disk(path, temporary, otherwise):
        temporary.mkdir()
        yield temporary
        with uninterrupted():
            shutil.rmtree(path, ignore_errors=True)
            os.replace(temporary, path)


def being_written() -> frozenset[Path]:
    """The temporary files and folders of this process."""
    return frozenset(_being_written)


def remove_unfinished(other_than: frozenset[Path] = frozenset()) -> None:
    """Remove what was being written where an interruption cut the clean-up short, at the end of a program."""
    for temporary in being_written() - other_than:
        _remove(temporary)


@contextmanager
def _unfinished(folder: Path, stem: str, suffix: str = "") -> Iterator[Path]:
    """A name in a folder, not yet taken, of what is gone at the end of the block unless it was renamed."""
    temporary = folder / f".{stem}.{secrets.token_hex(4)}{suffix}"
    _being_written.add(temporary)
    try:
        yield temporary
    finally:
        _remove(temporary)


def _remove(temporary: Path) -> None:
    with uninterrupted():
        if temporary.is_dir():
            shutil.rmtree(temporary, ignore_errors=True)
        else:
            with suppress(OSError):
                temporary.unlink()
        _being_written.discard(temporary)


@contextmanager
def _naming_the_disk(path: Path, temporary: Path, otherwise: str = "choose another folder") -> Iterator[None]:
    """Say that the disk is full where that is why `temporary`, which becomes `path`, cannot be written."""
    try:
        yield
    except FullDiskError as error:
        inner = Path(error.filename)
        if temporary in (inner, *inner.parents):
            error.filename = str(path / inner.relative_to(temporary))
        raise
    except Exception as error:
        if not _disk_is_full(error, temporary.parent):
            if type(error).__name__ == "SafetensorError":  # which is no OSError
                raise OSError(errno.EIO, f"cannot be written ({error})", str(path)) from None
            raise
        named = getattr(error, "filename", None)
        elsewhere = isinstance(named, str) and temporary not in (Path(named), *Path(named).parents)
        target = Path(named) if isinstance(named, str) and elsewhere else path
        mount = next(folder for folder in target.absolute().parents if os.path.ismount(folder))
        full = "your quota is used up" if getattr(error, "errno", None) == errno.EDQUOT else "it is full"
        text = f"cannot be written to the disk at {mount}: {full}; make room there, or {otherwise}"
        raise FullDiskError(errno.ENOSPC, text, str(target)) from None


def _disk_is_full(error: Exception, folder: Path) -> bool:
    """Whether an error is one of a full disk. Writers in C and C++ say so in words, or not at all."""
    if isinstance(error, OSError) and error.errno is not None:
        return error.errno in (errno.ENOSPC, errno.EDQUOT)
    if _FULL_DISK.search(str(error)):
        return True
    return isinstance(error, (OSError, RuntimeError)) and shutil.disk_usage(folder).free < _PRACTICALLY_NOTHING


def _unwritable(error: OSError, path: Path) -> OSError:
    return type(error)(error.errno, f"cannot write here ({_hindrance(error, path)}); choose another folder", str(path))


def _hindrance(error: OSError, path: Path) -> str:
    """Why nothing can be made at a path; in the system's words where they name it."""
    there = next(place for place in (path, *path.absolute().parents) if place.exists())
    if there == path and not path.is_dir():
        return "a file has this name"
    if not there.is_dir():
        return f"{there} is a file, no folder"
    if error.errno == errno.ENOENT:
        missing = path.absolute().parent != there
        return f"there is no folder {path.parent}" if missing else f"{there} takes no new files"
    return str(error.strerror)


def check_room(folder: Path, size: float, what: str) -> None:
    """Raises OSError where the disk of a cache folder has no room for `size` bytes."""
    free = shutil.disk_usage(folder).free
    if free < size:
        raise OSError(
            f"{folder}: {what} needs {size / 1e9:.2f} GB, {free / 1e9:.2f} GB are free; make room or {OTHER_DISK}"
        )


def cache_folder() -> Path:
    """Where caches live: $TORCHBRDF_CACHE, else the user's cache folder of this system."""
    from platformdirs import user_cache_path

    chosen = os.environ.get("TORCHBRDF_CACHE")
    return Path(chosen).expanduser() if chosen else user_cache_path("torchbrdf")
