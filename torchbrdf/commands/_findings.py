"""What a command found: lines for people as they come, or one JSON document for scripts at the end."""

import argparse
import json
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from math import isfinite
from pathlib import Path
from typing import Any, Self

from torchbrdf._version import __version__
from torchbrdf.progress import above_bars, no_progress


class Note(UserWarning):
    """What is worth knowing of a result that is no worse for it: a line on standard output, nothing to `--strict`."""


class Findings:
    """The way of a command to standard output.

    warnings  all that were said; notes: likewise
    error     what ended the command; None where nothing did
    """

    def __init__(self, command: str | None, quiet: bool = False, as_json: bool = False) -> None:
        """Nothing is found yet.

        command  its name; None where options were too bad to tell
        quiet    neither lines nor bars of progress
        as_json  the document, and no lines
        """
        self._command, self._quiet, self._as_json = command, quiet, as_json
        self._values: dict[str, Any] = {}
        self._files: list[str] = []
        self.warnings: list[str] = []
        self.notes: list[str] = []
        self.error: str | None = None
        self._lost: OSError | None = None

    @classmethod
    def of(cls, options: argparse.Namespace) -> Self:
        """As the options of a command ask for it."""
        return cls(options.command, getattr(options, "quiet", False), getattr(options, "json", False))

    def line(self, text: object, at_once: bool = False) -> None:
        """Print a line, or several, for people; `at_once` for one that is waited for."""
        if not (self._quiet or self._as_json):
            with above_bars():
                self._print(text, at_once)

    def add(self, **values: Any) -> None:
        """Values for scripts: whatever JSON holds, paths, tensors, and mappings and sequences of them."""
        self._values |= values

    def add_files(self, *paths: str | Path) -> None:
        """Files that were written."""
        self._files += map(str, paths)

    def failed(self, message: str) -> None:
        """What ended the command."""
        self.error = message

    @contextmanager
    def gathered(self) -> Iterator[None]:
        """The block in which the command runs: standard output is for the document where that is asked for."""
        with ExitStack() as block:
            if self._quiet:
                block.enter_context(no_progress())
            if self._as_json:
                block.enter_context(redirect_stdout(sys.stderr))
            yield

    def finish(self, status: int) -> OSError | None:
        """Print the notes, or the document where that is asked for.

        returns  why standard output does not hold all that was printed; None where it does, and where whoever read it
                 has closed the pipe, which is no error
        """
        for text in self.notes:
            self.line(f"note: {text}")
        if self._as_json:
            self._print(json.dumps(self.document(status), indent=2, allow_nan=False))
        self._print(end="", at_once=True)
        if self._lost is not None:
            _drop_output()
        return None if isinstance(self._lost, BrokenPipeError) else self._lost

    def _print(self, text: object = "", at_once: bool = False, end: str = "\n") -> None:
        """Nothing more once standard output did not take something: the work goes on, `finish` tells."""
        if self._lost is None:
            try:
                print(text, end=end, flush=at_once)
            except OSError as error:
                self._lost = error

    def document(self, status: int) -> dict[str, Any]:
        """What a script reads: what all commands tell, then what this one found."""
        told = {
            "command": self._command,
            "version": __version__,
            "status": status,
            "error": self.error,
            "warnings": self.warnings,
            "notes": self.notes,
            "files": self._files,
        }
        return {key: _plain(value) for key, value in (told | self._values).items()}


def _drop_output() -> None:
    """Send to nowhere what standard output holds back, which Python would write, and complain of, at its end."""
    with suppress(OSError):  # no file lies beneath
        nowhere = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(nowhere, sys.stdout.fileno())
        finally:
            os.close(nowhere)


def _plain(value: Any) -> Any:
    """A value as JSON holds it; numbers that are not finite are null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not isfinite(value) else value
