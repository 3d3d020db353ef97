"""How every command and script says what is wrong: one line on stderr, and an exit status."""

import argparse
import os
import re
import signal
import sys
from collections.abc import Callable
from itertools import takewhile
from typing import Any, Literal, NoReturn, Self, TextIO

from torchbrdf.files import being_written, did_you_mean, remove_unfinished
from torchbrdf.interruption import interruptible

BAD_INPUT = 2
WARNED = 3
INTERRUPTED = 130

_COLOURS = {"error": "1;31", "warning": "1;33"}
"""Of the label before a message on a terminal: bold red and bold yellow, which dark and light ground show."""

_NEGATIVE_NUMBER = re.compile(r"-(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$|-(inf|infinity|nan)$", re.I)
_OUT_OF_MEMORY = re.compile("can't allocate memory|out of memory", re.I)

RESUMABLE = "interrupted; the same command goes on where it stopped"
"""What is said after Ctrl-C where what is finished is kept."""


class BadUsageError(SystemExit):
    """The end of a program whose options are wrong, after one line.

    message  of that line
    """

    def __init__(self, message: str) -> None:
        """Exit status BAD_INPUT."""
        super().__init__(BAD_INPUT)
        self.message = message


class _Paragraphs(argparse.HelpFormatter):
    """Help whose paragraphs stay apart, and whose indented ones, which are examples, stay as they are."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        paragraphs = re.split(r"\n\s*\n", text)
        return "\n\n".join(
            one if "\n    " in one else super(_Paragraphs, self)._fill_text(one, width, indent) for one in paragraphs
        )


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, as those of `exit_status`, and to which -1e-3 and -inf are numbers."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        """See argparse, which takes what looks like no number and begins with a minus for an option."""
        super().__init__(*arguments, **{"formatter_class": _Paragraphs} | settings)
        self._negative_number_matcher = _NEGATIVE_NUMBER

    @classmethod
    def of_script(cls, text: str | None) -> Self:
        """A parser whose help shows the docstring of a script as it stands."""
        return cls(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse does, but nothing is left over: an unknown word is an error of the command that it is given to.

        It is told before what is missing, as a misspelt option often is what is.
        """
        words = sys.argv[1:] if args is None else list(args)
        own = takewhile(lambda word: word.startswith("-"), words) if self._subparsers else words
        for word in takewhile(lambda word: word != "--", own):
            name = word.partition("=")[0]
            if self._looks_like_option(name) and not any(map(_spells(name), self._option_string_actions)):
                self.error(f"unrecognized arguments: {name}{did_you_mean(name, self._option_string_actions)}")
            meant = [option for option in self._option_string_actions if option.startswith(name)]
            if name.startswith("--") and name not in meant and len(meant) > 1:
                self.error(f"ambiguous option: {name}{_first_of(meant)}; it could be {', '.join(meant)}")
        options, left = super().parse_known_args(words, namespace)
        if left:
            self.error(f"unrecognized arguments: {' '.join(left)}")
        return options, left

    def _looks_like_option(self, word: str) -> bool:
        return len(word) > 1 and word[0] == "-" and " " not in word and not _NEGATIVE_NUMBER.match(word)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Of choices: one that is nearly right is told the nearest, not all."""
        wrong = isinstance(value, str) and action.choices is not None and value not in action.choices
        if wrong and (close := did_you_mean(value, map(str, action.choices or ()))):
            raise argparse.ArgumentError(action, f"invalid choice: {value!r}{close}")
        super()._check_value(action, value)

    def error(self, message: str) -> NoReturn:
        """Say it and leave with BAD_INPUT."""
        line = f"{message}; see `{self.prog} --help`"
        fail(self.prog.split()[0], line)
        raise BadUsageError(line)


def _spells(word: str) -> Callable[[str], bool]:
    """Whether an option is meant by a word: whole, abbreviated, or of one letter with its value behind it."""
    return lambda option: option.startswith(word) or (len(option) == 2 and option[1] != "-" and word.startswith(option))


def _first_of(options: list[str]) -> str:
    """The end of a message about an abbreviation of all these: the one with which all begin; empty where none is."""
    shortest = min(options, key=len)
    return f" (did you mean {shortest}?)" if all(option.startswith(shortest) for option in options) else ""


def exit_status(
    name: str,
    run: Callable[[argparse.Namespace], int | None],
    options: argparse.Namespace,
    interrupted: str | None = None,
    told: Callable[[str], object] | None = None,
) -> int:
    """Run a program: what it returns, else 0; BAD_INPUT after one line for bad input or without Mitsuba.

    name         of the program, before what is said
    interrupted  what to say after Ctrl-C, unless the interruption says it itself; None to say nothing
    told         called with what is said of an error or an interruption
    After Ctrl-C INTERRUPTED, after SIGTERM 143, after SIGHUP 129: 128 and the signal, which is said.
    """
    message: str | None = None
    label: Literal["error"] | None = None
    others = being_written()
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
                status, message, label = BAD_INPUT, in_words(error), "error"
        finally:
            if interruption.raised:
                remove_unfinished(others)
    if interruption.raised and interruption.received not in (None, signal.SIGINT):
        status, message = 128 + interruption.received, f"{message or 'ended'} ({interruption.received.name})"
    if message is not None:
        say(name, message, label)
        if told is not None:
            told(message)
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


def say(name: str, message: str, label: Literal["error", "warning"] | None = None) -> None:
    """One line on stderr.

    label  before the message, in colour where `in_colour` says so
    """
    text = " ".join(message.split())
    if label is not None:
        text = f"\x1b[{_COLOURS[label]}m{label}:\x1b[0m {text}" if in_colour(sys.stderr) else f"{label}: {text}"
    print(f"{name}: {text}", file=sys.stderr)


def in_colour(stream: TextIO) -> bool:
    """Whether what goes to a stream is coloured: on terminals, unless NO_COLOR or TERM=dumb forbid it.

    FORCE_COLOR wants it elsewhere, too; a variable that is empty says nothing.
    """
    if os.environ.get("NO_COLOR"):
        return False
    if os.environ.get("FORCE_COLOR"):
        return True
    understood = os.name == "posix" or "WT_SESSION" in os.environ
    return understood and os.environ.get("TERM") != "dumb" and stream.isatty()


def fail(name: str, message: str) -> int:
    """One line on stderr about an error; returns BAD_INPUT."""
    say(name, message, "error")
    return BAD_INPUT
