"""The command line: `torchbrdf demo | fit | live | compare | analytic | render | bake | export | ...`."""

import argparse
import atexit
import gc
import io
import os
import sys
import warnings
from collections.abc import Sequence

import torchbrdf
from torchbrdf import commands
from torchbrdf.brdf import TABLE_SUFFIXES
from torchbrdf.command_line import BAD_INPUT, WARNED, BadUsageError, exit_status, say
from torchbrdf.interruption import uninterrupted


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit status.

    0; 2 for bad input (one line on stderr); 3 for warnings with `--strict`; else as `exit_status`.
    """
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")  # as stderr does: no name of a file ends a command
    words = sys.argv[1:] if arguments is None else list(arguments)
    try:
        options = parser(*words[:1]).parse_args(words)
    except BadUsageError as error:
        _finish_without_options(words, error)
        raise
    except SystemExit:  # after --help and --version
        sys.exit(_finished(commands.Findings(None), 0))
    findings = commands.Findings.of(options)

    def show(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
        if issubclass(category, commands.Note):
            findings.notes.append(str(message))
            return
        findings.warnings.append(str(message))
        say(commands.NAME, str(message), "warning")

    def run(options: argparse.Namespace) -> int:
        with findings.gathered():
            return _run(options, findings)

    warnings.showwarning = show
    interrupted = "interrupted; nothing was written"
    status = exit_status(commands.NAME, run, options, interrupted, told=findings.failed)
    if status == 0 and findings.warnings and getattr(options, "strict", False):
        count = len(findings.warnings)
        say(commands.NAME, f"{count} warning{'s' * (count > 1)} with --strict; what was written stays")
        status = WARNED
    return _finished(findings, status)


def _finished(findings: commands.Findings, status: int) -> int:
    """Print what is left; the exit status, BAD_INPUT where standard output does not take what people wait for."""
    error = findings.finish(status)
    if error is None:
        return status
    say(commands.NAME, f"standard output: cannot be written ({error.strerror}); files that were written stay", "error")
    return status or BAD_INPUT


def _finish_without_options(words: Sequence[str], error: BadUsageError) -> None:
    """Print the document of a command whose options are wrong, where one of them asks for it."""
    asked = any(len(word) > 2 and "--json".startswith(word) for word in words)
    findings = commands.Findings(words[0] if words and words[0] in commands.names() else None, as_json=asked)
    findings.failed(error.message)
    _finished(findings, BAD_INPUT)


def _run(options: argparse.Namespace, findings: commands.Findings) -> int:
    _refuse_to_overwrite_inputs(options)
    if options.computes:
        _load_torch()
    return int(options.run(options, findings) or 0)


def _load_torch() -> None:
    """Import it while no garbage is collected, and keep what it holds out of all later collections.

    They would go through its quarter of a million objects, again and again while they are made and twice at the end:
    half a second of a short command. NumPy's products and factorisations are small: its threads, which wait by turning
    round, would take the processors from PyTorch's, and a ball takes a quarter longer to be found. A KeyboardInterrupt
    in the initialisers of its extensions would be lost: signals wait for the end.
    """
    if "torch" in sys.modules:
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.disable()
    try:
        with uninterrupted():
            import torch  # noqa: F401
    finally:
        gc.freeze()
        gc.enable()
    atexit.register(gc.freeze)


def _refuse_to_overwrite_inputs(options: argparse.Namespace) -> None:
    """Raise ValueError where the output is a file that is read, or a table of a folder that is, by any name."""
    output = getattr(options, "output", None) or getattr(options, "written", None)
    if output is None or not output.is_file():
        return
    table = output.suffix.lower() in TABLE_SUFFIXES
    for path in commands.inputs_of(options):
        if output.samefile(path) or (table and output.parent.samefile(path)):
            raise ValueError(f"{output}: the output is an input, which would be lost; give the output another name")


def parser(wanted: str | None = None) -> argparse.ArgumentParser:
    """That of the program, with all commands; with one alone where that is wanted."""
    return commands.parser(torchbrdf.__doc__, wanted)


if __name__ == "__main__":
    sys.exit(main())
