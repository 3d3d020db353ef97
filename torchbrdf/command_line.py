"""How every command and script says what is wrong: one line on stderr, and an exit status."""

import argparse
import sys
from collections.abc import Callable
from typing import NoReturn, Self

BAD_INPUT = 2
WARNED = 3
INTERRUPTED = 130

RESUMABLE = "interrupted; the same command goes on where it stopped"
"""What is said after Ctrl-C where what is finished is kept."""


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, as those of `exit_status`."""

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
    """Run a program: what it returns, else 0; BAD_INPUT after one line for bad input or without Mitsuba; INTERRUPTED.

    name         of the program, before what is said
    interrupted  what to say after Ctrl-C, unless the interruption says it itself; None to say nothing
    """
    try:
        return run(options) or 0
    except OSError as error:
        return fail(name, f"{error.filename}: {error.strerror}" if error.filename and error.strerror else str(error))
    except ValueError as error:
        return fail(name, str(error))
    except ImportError as error:
        from torchbrdf.mitsuba_startup import MitsubaUnavailableError

        if not isinstance(error, MitsubaUnavailableError):
            raise
        return fail(name, str(error))
    except KeyboardInterrupt as interruption:
        if message := str(interruption) or interrupted:
            say(name, message)
        return INTERRUPTED


def say(name: str, message: str) -> None:
    """One line on stderr."""
    print(f"{name}: " + " ".join(message.split()), file=sys.stderr)


def fail(name: str, message: str) -> int:
    """One line on stderr about an error; returns BAD_INPUT."""
    say(name, f"error: {message}")
    return BAD_INPUT
