"""Progress on stderr: bars on a terminal, a line now and then elsewhere; where a call asks for it, unless hidden."""

import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TYPE_CHECKING, Any, TextIO, TypeVar, overload

if TYPE_CHECKING:  # what shows no bar need not wait for it
    from tqdm import tqdm

Item = TypeVar("Item")

_SECONDS = 30.0
"""Between two lines of what is no terminal."""
_PATIENCE = 10.0
"""Seconds of silence after which it is said what they are spent on."""

_LINE = "{desc}: {n_fmt} of {total_fmt} after {elapsed}, {remaining} left"

_hidden = 0


class _Lines:
    """Stands for stderr where it is no terminal: what a bar writes there becomes lines, what wipes it out nothing."""

    def write(self, text: str) -> int:
        """As that of a stream."""
        if line := text.strip("\r\n "):
            sys.stderr.write(f"{line}\n")
        return len(text)

    def flush(self) -> None:
        """As that of a stream."""
        sys.stderr.flush()


@overload
def progress_bar(*, shown: bool = True, leave: bool = False, **settings: Any) -> "tqdm[Any]": ...
@overload
def progress_bar(
    iterable: Iterable[Item], *, shown: bool = True, leave: bool = False, **settings: Any
) -> "tqdm[Item]": ...
def progress_bar(iterable: Any = None, *, shown: bool = True, leave: bool = False, **settings: Any) -> "tqdm[Any]":
    """A bar of tqdm, over what is iterated or for `update`; silent in a block of `no_progress`.

    shown     whether the caller asks for it
    leave     it stays where it is when it is full
    settings  of tqdm: desc, total, initial, unit
    Where stderr is neither a terminal nor a notebook there is no bar but a line every half minute, the first after one.
    """
    from tqdm import tqdm

    if not _draws(sys.stderr):
        # miniters: else what is iterated counts only so often, and tqdm's other thread prints a count that is old
        every = {"mininterval": _SECONDS, "maxinterval": _SECONDS, "delay": _SECONDS, "miniters": 1}
        settings = every | {"bar_format": _LINE, "file": _Lines(), "position": 0} | settings  # one in another: no moves
    return tqdm(iterable, leave=leave, disable=not shown or _hidden > 0, **settings)


def _draws(stream: TextIO) -> bool:
    """Whether what is written to a stream may be wiped out and written anew."""
    return stream.isatty() or type(stream).__module__.startswith("ipykernel")


def announce(text: str, shown: bool = True) -> None:
    """A line on stderr about what takes long, where a bar would be shown or its lines."""
    if shown and _hidden == 0:
        with above_bars():
            print(text, file=sys.stderr, flush=True)


@contextmanager
def told_if_slow(text: str) -> Iterator[None]:
    """Announce what the block does once it has taken ten seconds: on a quiet machine it takes fewer."""
    timer = threading.Timer(_PATIENCE, announce, [text])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextmanager
def no_progress() -> Iterator[None]:
    """In the block no bar is shown, whoever asks for one."""
    global _hidden
    _hidden += 1
    try:
        yield
    finally:
        _hidden -= 1


def above_bars() -> AbstractContextManager[None]:
    """In the block a line may be printed: bars make way for it."""
    loaded = sys.modules.get("tqdm")
    return nullcontext() if loaded is None else loaded.tqdm.external_write_mode()
