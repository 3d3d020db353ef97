"""A task of a sweep, and the function that all of them call, in any process."""

import importlib
import sys
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from torchbrdf._version import __version__
from torchbrdf.threads import one_thread

Finished = Generator[tuple["Task", Any], None, None]
"""Tasks and their results, as they come."""


@dataclass(frozen=True)
class Task:
    """One call of the sweep's function, with `**arguments, **places`.

    name       also of the file of its result, so without path separators
    arguments  all that the result depends on
    places     where things lie, such as paths of what `arguments` holds fingerprints of: they may change between runs
    """

    name: str
    arguments: Mapping[str, Any]
    places: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Call:
    """A function by name, so that any process can find it.

    folder    where its module (or the module's package) lies
    versions  of torchbrdf and torch, which must be the same in all processes
    """

    module: str
    function: str
    folder: str
    versions: tuple[str, str]

    @classmethod
    def of(cls, function: Callable[..., Any]) -> "Call":
        """Raises ValueError for a function that other processes cannot import by its name."""
        module, name = getattr(function, "__module__", None), getattr(function, "__qualname__", repr(function))
        source = getattr(sys.modules.get(str(module)), "__file__", None)
        if module is None or module == "__main__" or source is None or not name.isidentifier():
            raise ValueError(f"a sweep needs a function of a module that can be imported, got {module}.{name}")
        return cls(module, name, str(Path(source).resolve().parents[module.count(".")]), versions())

    def __call__(self, task: Task) -> Any:
        """The result of a task, in any process."""
        if versions() != self.versions:
            raise ValueError(
                "processes of a sweep must have the same torchbrdf and torch, got "
                f"{', '.join(versions())} on a worker and {', '.join(self.versions)} here"
            )
        if self.folder not in sys.path:
            sys.path.append(self.folder)
        function = getattr(importlib.import_module(self.module), self.function)
        with one_thread():
            return function(**task.arguments, **task.places)


def versions() -> tuple[str, str]:
    """Of torchbrdf and torch."""
    return __version__, torch.__version__
