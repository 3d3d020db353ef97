"""Run a command and write down what it has loaded: `python -m speed.imports FILE COMMAND ...`."""

import json
import sys
from contextlib import suppress
from pathlib import Path


def loaded() -> list[str]:
    """Modules of torchbrdf and packages of others, in the order in which they were loaded."""
    return [
        name
        for name in sys.modules
        if name.startswith("torchbrdf.")
        or not ("." in name or name.startswith("_") or name in sys.stdlib_module_names or name == "speed")
    ]


def main() -> None:
    from torchbrdf.cli import main as command_line

    with suppress(SystemExit):
        command_line(sys.argv[2:])
    Path(sys.argv[1]).write_text(json.dumps(loaded()))


if __name__ == "__main__":
    main()
