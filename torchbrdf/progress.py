"""Bars of progress on stderr: shown where a call asks for them, and nowhere while they are hidden."""

import sys
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TYPE_CHECKING, Any, TypeVar, overload

if TYPE_CHECKING:  # what shows no bar need not wait for it
    from tqdm import tqdm

Item = TypeVar("Item")

_hidden = 0


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
    """
    from tqdm import tqdm

    return tqdm(iterable, leave=leave, disable=not shown or _hidden > 0, **settings)


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
