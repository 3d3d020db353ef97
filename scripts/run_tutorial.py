#!/usr/bin/env python3
"""Run the commands of a page of the documentation, as typed, one after another; stop where one fails.

    python scripts/run_tutorial.py -o FOLDER                  # docs/tutorial.md

The commands are the lines that begin with "$ " in blocks of ```console. A shell runs them in FOLDER, where `scripts`
leads to this folder.
"""

import argparse
import re
import subprocess
import sys
import time
from pathlib import Path

from torchbrdf.command_line import Parser, exit_status

ROOT = Path(__file__).resolve().parent.parent
FAILED = 1
"""Exit status."""


def commands_of(page: Path) -> list[str]:
    """The commands of a page. Raises ValueError where there are none."""
    blocks = re.findall(r"^```console\n(.*?)^```$", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    found = [line[2:] for block in blocks for line in block.splitlines() if line.startswith("$ ")]
    if not found:
        raise ValueError(f'{page}: no command here; they begin with "$ " in blocks of ```console')
    return found


def run(options: argparse.Namespace) -> int:
    """Run all, and say how long each took."""
    commands = commands_of(options.page)
    options.output.mkdir(parents=True, exist_ok=True)
    scripts = options.output / "scripts"
    if not scripts.exists():
        scripts.symlink_to(ROOT / "scripts")
    for command in commands:
        print(f"$ {command}", flush=True)
        start = time.monotonic()
        status = subprocess.run(["bash", "-c", command], cwd=options.output, check=False).returncode
        if status:
            print(f"failed with status {status}")
            return FAILED
        print(f"took {time.monotonic() - start:.1f} s", flush=True)
    return 0


def main() -> int:
    parser = Parser.of_script(__doc__)
    tutorial = ROOT / "docs" / "tutorial.md"
    parser.add_argument("page", type=Path, nargs="?", default=tutorial, help="default: docs/tutorial.md")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to run them in")
    return exit_status("run_tutorial", run, parser.parse_args(), "interrupted")


if __name__ == "__main__":
    sys.exit(main())
