"""How every command and script says what is wrong: one line on stderr, and an exit status."""

import argparse
import re
import signal
import sys
from collections.abc import Callable
from typing import Any, NoReturn, Self

from torchbrdf.files import being_written, remove_unfinished
from torchbrdf.interruption import interruptible

BAD_INPUT = 2
WARNED = 3
INTERRUPTED = 130

_NEGATIVE_NUMBER = re.compile(r"-(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$|-(inf|infinity|nan)$", re.I)
_OUT_OF_MEMORY = re.compile("can't allocate memory|out of memory", re.I)

RESUMABLE = "interrupted; the same command goes on where it stopped"
"""What is said after Ctrl-C where what is finished is kept."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, as those of `exit_status`, and to which -1e-3 and -inf are numbers."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        """See argparse, which takes what looks like no number and begins with a minus for an option."""
        super().__init__(*arguments, **settings)
        self._negative_number_matcher = _NEGATIVE_NUMBER

    @classmethod
    def of_script(cls, text: str | None) -> Self:
        """A parser whose help shows the docstring of a script as it stands."""
        return cls(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)

    def error(self, message: str) -> NoReturn:
        """Say it and leave with BAD_INPUT."""
        fail(self.prog.split()[0], f"{message}; see `{self.prog} --help`")
        raise SystemExit(BAD_INPUT)


def exit_status(
    name: str,
    run: Callable[[argparse.Namespace], int | None],
    options: argparse.Namespace,
    interrupted: str | None = None,
) -> int:
    """Run a program: what it returns, else 0; BAD_INPUT after one line for bad input or without Mitsuba.

    name         of the program, before what is said
    interrupted  what to say after Ctrl-C, unless the interruption says it itself; None to say nothing
    After Ctrl-C INTERRUPTED, after SIGTERM 143, after SIGHUP 129: 128 and the signal, which is said.
    """
    message, others = None, being_written()
    with interruptible() as interruption:
        try:
            try:
                status = run(options) or 0
            finally:
                interruption.close()
        except KeyboardInterrupt as error:
            status, message = INTERRUPTED, str(error) or interrupted
        except Exception as error:
            if interruption.raised:  # as what ran in C or in another process passes it on
                status, message = INTERRUPTED, interrupted
            else:
                status = fail(name, in_words(error))
        finally:
            if interruption.raised:
                remove_unfinished(others)
    if interruption.raised and interruption.received not in (None, signal.SIGINT):
        say(name, f"{message or 'ended'} ({interruption.received.name})")
        return 128 + interruption.received
    if message:
        say(name, message)
    return status


def in_words(error: Exception) -> str:
    """What is wrong with the input or this machine; raises errors that are neither."""
    if isinstance(error, OSError):
        return f"{error.filename}: {error.strerror}" if error.filename and error.strerror else str(error)
    if isinstance(error, ValueError):
        return str(error)
    if isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and _OUT_OF_MEMORY.search(str(error))):
        return "not enough memory for that: ask for fewer pixels, samples or materials"
    if isinstance(error, ImportError):
        from torchbrdf.mitsuba_startup import MitsubaUnavailableError

        if isinstance(error, MitsubaUnavailableError):
            return str(error)
    raise error


def say(name: str, message: str) -> None:
    """One line on stderr."""
    print(f"{name}: " + " ".join(message.split()), file=sys.stderr)


def fail(name: str, message: str) -> int:
    """One line on stderr about an error; returns BAD_INPUT."""
    say(name, f"error: {message}")
    return BAD_INPUT
