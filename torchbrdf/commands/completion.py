"""`torchbrdf completion`: what the shell needs to complete commands, options, their values and files."""

import argparse
from collections.abc import Iterator, Sequence
from typing import Any

from torchbrdf.analytic import models
from torchbrdf.brdf import TABLE_SUFFIXES
from torchbrdf.commands._findings import Findings

EXAMPLES = ('eval "$(torchbrdf completion bash)"', "torchbrdf completion zsh > ~/.zfunc/_torchbrdf")

PICTURES = ("exr", "hdr", "jpeg", "jpg", "npy", "pfm", "pic", "png", "tif", "tiff")
MESHES = ("ply", "obj", "glb", "gltf")
RAW = (
    "3fr", "arw", "cr2", "cr3", "crw", "dng", "erf", "iiq", "kdc", "mos", "mrw", "nef", "nrw", "orf", "pef", "raf",
    "raw", "rw2", "rwl", "sr2", "srf", "srw", "x3f",
)  # fmt: skip
"""Suffixes as the readers have them, which would take seconds to ask: a shell asks for the script as it starts."""

_TABLES = tuple(suffix.removeprefix(".") for suffix in TABLE_SUFFIXES)
_LIGHT = (PICTURES, ("default",))
_VALUES: dict[str, tuple[Sequence[str], Sequence[str]]] = {
    "photos": (PICTURES, ()),
    "photo": (PICTURES, ()),
    "images": ((*PICTURES, *RAW), ()),
    "like": (("exr",), ()),
    "mask": (PICTURES, ()),
    "probe_mask": (PICTURES, ()),
    "light_mask": (PICTURES, ()),
    "probe": _LIGHT,
    "light": _LIGHT,
    "probes": (PICTURES, ()),
    "view": ((*MESHES, *PICTURES), ("sphere",)),
    "basis": (("safetensors",), ()),
    "library": (_TABLES, ("default",)),
    "paths": (_TABLES, ("default",)),
    "brdf": (_TABLES, ()),
    "converted": ((*_TABLES, *PICTURES), ()),
    "written": (("*",), ()),
    "brdfs": (_TABLES, ()),
    "preview": (("exr", "hdr", "jpg", "png"), ()),
    "penalty": ((), ("auto", "paper")),
    "model": ((), models.NAMES),
    "output": (("*",), ()),
}
"""Suffixes of files, and words, that an option or argument takes, by its destination."""

_AMENDED = {
    "bash": ('positional" = true )', 'positional" = true || "$current_action_nargs" = "+" )'),
    "zsh": ('"(*):', '"*:'),
}
"""Of shtab's scripts: in bash an option may follow one that takes several files, in zsh all arguments are completed."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which shell."""
    parser.add_argument("shell", choices=("bash", "zsh"), help="that reads the script")


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Print a script by which bash or zsh completes commands, options, their values and files.

    The shell reads it once, as it starts; completing then starts no program.
    """
    from shtab import complete

    from torchbrdf import commands

    whole = commands.parser()
    for action in _actions(whole):
        if not action.choices and action.dest in _VALUES:
            action.complete = _completer(action.dest)  # type: ignore[attr-defined]
        if options.shell == "zsh" and action.option_strings:
            action.metavar = _arguments_in_zsh(action)
    findings.line(complete(whole, options.shell).replace(*_AMENDED[options.shell]))
    return 0


def _arguments_in_zsh(action: argparse.Action) -> str | None:
    """What stands between the colons of an option's specification, where shtab has one argument of several."""
    return ": :".join(action.metavar) if isinstance(action.metavar, tuple) else action.metavar


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from _actions(command)


def _completer(name: str) -> dict[str, Any]:
    """A function of each shell that offers the words and files of `_VALUES`, as shtab takes it."""
    suffixes, words = _VALUES[name]
    called = f"_torchbrdf_file_{name}" if suffixes else f"_torchbrdf_{name}"  # shtab quotes what it takes for a file
    bash = [f"compgen -W '{' '.join(words)}' -- \"$1\""] if words else []
    zsh = [f"compadd -- {' '.join(words)}"] if words else []
    if suffixes:
        patterns = ["*" if suffix == "*" else f"*.{_in_any_case(suffix)}" for suffix in suffixes]
        bash += [f"compgen -f -X '!{pattern}' -- \"$1\"" for pattern in patterns] + ['compgen -d -- "$1"']
        zsh += ["_files" if suffixes == ("*",) else f"_files -g '({'|'.join(patterns)})'"]
    lines = {"bash": bash, "zsh": zsh}
    functions = {shell: "\n  ".join([f"{called}() {{", *body]) + "\n}" for shell, body in lines.items()}
    return {"bash": called, "zsh": called, "preamble": functions}


def _in_any_case(suffix: str) -> str:
    """A pattern of the shell: cameras write IMG_0001.JPG."""
    return "".join(f"[{letter}{letter.upper()}]" if letter.isalpha() else letter for letter in suffix)
