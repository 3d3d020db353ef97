"""What each command of the command line takes and does, one a file.

In: options. Out: files, lines or JSON on stdout, an exit status. A command is a module with `EXAMPLES`, which its help
shows, `add_options(parser)` and `run(options, found)`, whose docstring is its help, and which tells `found`, a
`Findings`, what people and scripts are to know. Every `--help` reads them all: what a command computes with is imported
when it runs. Modules that several share begin with an underscore.

To add a command, add a file here.
"""

from argparse import ArgumentParser
from importlib import import_module
from inspect import cleandoc
from pkgutil import iter_modules
from types import ModuleType

from torchbrdf._version import __version__
from torchbrdf.command_line import Parser
from torchbrdf.commands._findings import Findings as Findings, Note as Note
from torchbrdf.commands._options import inputs_of as inputs_of

NAME = "torchbrdf"
"""Of the program."""

_FIRST = (
    "demo", "merge", "probe", "observe", "fit", "live", "compare", "analytic", "render", "bake", "precompute", "export",
    "convert", "verify", "classes",
)  # fmt: skip
"""In the order in which a user meets them; the others follow by name."""

_DO_NOT_COMPUTE = ("completion", "doctor")
"""They need no torch, and the doctor says what is wrong with it."""

_ONLY_FOR_PEOPLE = ("completion", "live")
"""What a script would read of them is no document: a program of the shell, a page in the browser."""


def names() -> list[str]:
    """Of all commands, in the order of the help."""
    each = [module.name for module in iter_modules(__path__) if not module.name.startswith("_")]
    return sorted(each, key=lambda name: (_FIRST.index(name) if name in _FIRST else len(_FIRST), name))


def found(wanted: str | None = None) -> dict[str, ModuleType]:
    """Every command by name, in the order of the help; the one that is wanted alone, where it is one."""
    everything = names()
    return {name: import_module(f"{__name__}.{name}") for name in ([wanted] if wanted in everything else everything)}


def parser(about: str | None = None, wanted: str | None = None) -> ArgumentParser:
    """All commands with their options. Nothing is imported that only running one needs: `--help` answers at once.

    about   the program, in its help
    wanted  see `found`
    """
    whole = Parser(prog=NAME, description=about)
    whole.add_argument("--version", action="version", version=f"{NAME} {__version__}")
    chosen = whole.add_subparsers(required=True, metavar="COMMAND")
    for name, command in found(wanted).items():
        text = cleandoc(command.run.__doc__ or "")
        examples = "\n".join(f"    {line}" for line in command.EXAMPLES)
        added = chosen.add_parser(name, help=text.splitlines()[0], description=text, epilog=f"for example:\n{examples}")
        added.set_defaults(command=name, run=command.run, computes=name not in _DO_NOT_COMPUTE)
        command.add_options(added)
        if name != "completion":
            added.add_argument("--quiet", action="store_true", help="print errors and warnings alone")
        if name not in _ONLY_FOR_PEOPLE:
            text = "print one JSON document in the place of lines: what was found, files, warnings, the error"
            added.add_argument("--json", action="store_true", help=text)
    return whole
