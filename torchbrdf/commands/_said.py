"""Warnings of one photograph among several: each with its name, beside a bar of progress."""

import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from torchbrdf.progress import above_bars


@contextmanager
def kept(said: list[str]) -> Iterator[None]:
    """Warnings of the block are added to a list as they come, and not said."""

    def keep(message: Warning | str, *_: object, **__: object) -> None:
        said.append(str(message))

    with warnings.catch_warnings():
        warnings.filterwarnings("always", category=UserWarning)
        warnings.showwarning = keep
        yield


@contextmanager
def said_of(path: Path, said: list[str]) -> Iterator[None]:
    """Warnings of the block are said at its end, with the file's name, and added to a list as they are said."""
    texts: list[str] = []
    try:
        with kept(texts):
            yield
    finally:
        said.extend(named := [about(path, text) for text in texts])
        say(named)


def about(path: Path, text: str) -> str:
    """A text that names a file."""
    return text if str(path) in text else f"{path}: {text}"


def say(texts: Iterable[str]) -> None:
    """Warn of each."""
    for text in texts:
        with above_bars():
            warnings.warn(text, UserWarning, stacklevel=2)
