"""Ctrl-C, SIGTERM and SIGHUP while a program runs: each a KeyboardInterrupt, at a moment at which it does no harm."""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_ENDING = ("SIGINT", "SIGTERM", "SIGHUP")
_PATIENCE = 5.0
"""Seconds in which the clean-up that a signal began is not disturbed by another."""

_current: "Interruption | None" = None


class Interruption:
    """The signals that a program receives while it runs.

    received  the first of them; None where there was none
    raised    whether one was a KeyboardInterrupt already
    """

    def __init__(self) -> None:
        """None yet."""
        self.received: signal.Signals | None = None
        self.raised = False
        self._until = -float("inf")
        self._due = False
        self._holds = 0

    @contextmanager
    def held_back(self) -> Iterator[None]:
        """Signals wait for the end of the block."""
        self._holds += 1
        try:
            yield
        finally:
            self._holds -= 1
            self._raise_if_due()

    def handle(self, number: int, frame: FrameType | None) -> None:
        """As Python calls it."""
        self.received = self.received or signal.Signals(number)
        self._due = self._due or time.monotonic() > self._until
        self._raise_if_due()

    def close(self) -> None:
        """No more KeyboardInterrupt from here on."""
        self._holds += 1

    def _raise_if_due(self) -> None:
        if self._due and not self._holds:
            self._due, self.raised, self._until = False, True, time.monotonic() + _PATIENCE
            raise KeyboardInterrupt


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """In the block, signals that end a program raise KeyboardInterrupt; after it they do what they did before.

    Only in the main thread, and only signals that nobody else handles or ignores: `nohup` and programs that embed this
    one keep theirs. A block within the block is a part of it.
    """
    global _current
    if _current is not None or threading.current_thread() is not threading.main_thread():
        yield _current or Interruption()
        return
    known = [getattr(signal, name) for name in _ENDING if hasattr(signal, name)]
    free = [one for one in known if signal.getsignal(one) in (signal.SIG_DFL, signal.default_int_handler)]
    _current = Interruption()
    before = {one: signal.signal(one, _current.handle) for one in free}
    try:
        yield _current
    finally:
        _current = None
        for one, handler in before.items():
            signal.signal(one, handler)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Signals that `interruptible` takes wait for the end of the block, which is short."""
    if _current is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    with _current.held_back():
        yield
