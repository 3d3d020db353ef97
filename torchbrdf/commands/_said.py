"""What is said of photographs: warnings and notes, of one among several with its name, beside a bar of progress."""

import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from torchbrdf.commands._findings import Note
from torchbrdf.progress import above_bars
from torchbrdf.report import Doubt


@dataclass(frozen=True)
class Said:
    """A warning, or a note."""

    text: str
    is_note: bool = False

    def about(self, path: Path) -> "Said":
        """The same with the name of a file."""
        return self if str(path) in self.text else replace(self, text=f"{path}: {self.text}")


@contextmanager
def kept(said: list[Said]) -> Iterator[None]:
    """Warnings and notes of the block are added to a list as they come, and not said."""

    def keep(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
        said.append(Said(str(message), issubclass(category, Note)))

    with warnings.catch_warnings():
        warnings.filterwarnings("always", category=UserWarning)
        warnings.showwarning = keep
        yield


@contextmanager
def said_of(path: Path, said: list[Said]) -> Iterator[None]:
    """Those of the block are said at its end, with the file's name, and added to a list as they are said."""
    found: list[Said] = []
    try:
        with kept(found):
            yield
    finally:
        said.extend(named := [one.about(path) for one in found])
        say(named)


def say(found: Iterable[Said]) -> None:
    """Warn of each, or note it."""
    for one in found:
        with above_bars():
            warnings.warn(one.text, Note if one.is_note else UserWarning, stacklevel=2)


def say_doubts(doubts: Iterable[Doubt]) -> None:
    """Warn of each; of what a good result may have there is a note."""
    say(Said(doubt.text, doubt.is_harmless) for doubt in doubts)


def in_record(said: Iterable[Said]) -> dict[str, list[str]]:
    """What weights.json and a script are told of them."""
    found = list(said)
    return {
        "warnings": [one.text for one in found if not one.is_note],
        "notes": [one.text for one in found if one.is_note],
    }
