"""The imports of a command, and nothing else.

`python -m speed.imports --of FILE COMMAND ...` runs a command and writes down what it has loaded at its end, and
`python -m speed.imports MODULE ...` loads that.
"""

import sys
from contextlib import suppress
from importlib import import_module
from pathlib import Path


def loaded() -> list[str]:
    """Modules of torchbrdf and packages of others, in the order in which they were loaded."""
    strange = {"speed", *sys.stdlib_module_names}
    own = [name for name in sys.modules if name.startswith("torchbrdf.")]
    return own + [name for name in sys.modules if not ("." in name or name.startswith("_") or name in strange)]


def main() -> None:
    if sys.argv[1] == "--of":
        from torchbrdf.cli import main as command_line

        with suppress(SystemExit):
            command_line(sys.argv[3:])
        Path(sys.argv[2]).write_text("\n".join(loaded()))
        return
    for name in sys.argv[1:]:
        with suppress(ImportError):
            import_module(name)


if __name__ == "__main__":
    main()
