"""The command line: `torchbrdf demo | fit | live | compare | analytic | render | bake | export | ...`."""

import argparse
import atexit
import gc
import os
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

import torchbrdf
from torchbrdf import commands
from torchbrdf.command_line import WARNED, Parser, exit_status, say

NAME = "torchbrdf"

_LOOKS_ITSELF = "doctor"
"""The command that does not compute, and says what is wrong with torch."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit status.

    0; 2 for bad input (one line on stderr); 3 for warnings with `--strict`; else as `exit_status`.
    """
    options = parser().parse_args(arguments)
    shown: list[str] = []

    def show(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
        shown.append(str(message))
        say(NAME, f"warning: {message}")

    warnings.showwarning = show
    status = exit_status(NAME, _run, options, interrupted="interrupted; nothing was written")
    if status == 0 and shown and getattr(options, "strict", False):
        say(NAME, f"{len(shown)} warning{'s' * (len(shown) > 1)} with --strict; what was written stays")
        return WARNED
    return status


def _run(options: argparse.Namespace) -> int:
    _refuse_to_overwrite_inputs(options)
    if options.computes:
        _load_torch()
    return int(options.run(options) or 0)


def _load_torch() -> None:
    """Import it while no garbage is collected, and keep what it holds out of all later collections.

    They would go through its quarter of a million objects, again and again while they are made and twice at the end:
    half a second of a short command. NumPy's products and factorisations are small: its threads, which wait by turning
    round, would take the processors from PyTorch's, and a ball takes a quarter longer to be found.
    """
    if "torch" in sys.modules:
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.disable()
    try:
        import torch  # noqa: F401
    finally:
        gc.freeze()
        gc.enable()
    atexit.register(gc.freeze)


def _refuse_to_overwrite_inputs(options: argparse.Namespace) -> None:
    """Raise ValueError where the output is a file that is read, whatever either is called."""
    output = getattr(options, "output", None)
    if output is None or not output.is_file():
        return
    for name, value in vars(options).items():
        for path in value if isinstance(value, list) else [value]:
            if name != "output" and isinstance(path, str | Path) and Path(path).is_file() and output.samefile(path):
                raise ValueError(f"{output}: the output is an input, which would be lost; give the output another name")


def parser() -> argparse.ArgumentParser:
    """All commands with their options. Nothing is imported that only running one needs: `--help` answers at once."""
    whole = Parser(prog=NAME, description=torchbrdf.__doc__)
    whole.add_argument("--version", action="version", version=f"{NAME} {torchbrdf.__version__}")
    chosen = whole.add_subparsers(required=True, metavar="COMMAND")
    for name, command in commands.found().items():
        text = (command.run.__doc__ or "").strip()
        added = chosen.add_parser(name, help=text.splitlines()[0], description=text)
        added.set_defaults(run=command.run, computes=name != _LOOKS_ITSELF)
        command.add_options(added)
    return whole


if __name__ == "__main__":
    sys.exit(main())
