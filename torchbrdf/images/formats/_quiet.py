"""Decoders that print."""

import contextlib
import os
import sys
import threading
from collections.abc import Iterator
from typing import Any, TextIO

_one_at_a_time = threading.RLock()
"""Descriptor 2 and `sys.stderr` belong to all threads: of two that keep them and put them back, one would lose them."""


@contextlib.contextmanager
def quiet_decoders() -> Iterator[None]:
    """Drop what OpenEXR, libpng and tifffile print about a bad file, also from C (descriptor 2): we raise one line.

    What other threads print to `sys.stderr` and `sys.stdout` in the meantime is printed.
    """
    with _one_at_a_time, contextlib.ExitStack() as undo:
        sys.stderr.flush()
        shown = undo.enter_context(os.fdopen(os.dup(2), "w", buffering=1))
        undo.enter_context(contextlib.redirect_stdout(undo.enter_context(_OfOtherThreads(sys.stdout, sys.stdout))))
        beside = shown if _is_descriptor_2(sys.stderr) else sys.stderr
        undo.enter_context(contextlib.redirect_stderr(undo.enter_context(_OfOtherThreads(sys.stderr, beside))))
        with open(os.devnull, "w") as sink:
            os.dup2(sink.fileno(), 2)
        undo.callback(os.dup2, shown.fileno(), 2)
        yield


class _OfOtherThreads(contextlib.AbstractContextManager["_OfOtherThreads"]):
    """A stream whose block drops what its own thread writes; what others write goes beside, after the block back."""

    def __init__(self, stream: TextIO, beside: TextIO) -> None:
        self._stream, self._now, self._lock = stream, beside, threading.Lock()
        self._silent: int | None = threading.get_ident()

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._now, self._silent = self._stream, None

    def write(self, text: str) -> int:
        """As that of a stream."""
        with self._lock:
            return len(text) if threading.get_ident() == self._silent else self._now.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def _is_descriptor_2(stream: TextIO) -> bool:
    try:
        return stream.fileno() == 2
    except OSError:
        return False
