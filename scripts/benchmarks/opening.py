#!/usr/bin/env python3
"""Claim: the command line answers long before PyTorch could, and the public names take less than 2 s more than it.

    python scripts/benchmarks/opening.py --repeats 5

Each line is a process of its own: CPU time (user and system, of the process and its children) and wall time, medians,
and the ratio to `python -c "import torch"`, the machine's yardstick, in the same run.
"""

import os
import statistics
import subprocess
import sys
import time

from torchbrdf import commands
from torchbrdf.command_line import Parser
from torchbrdf.experiments import markdown_table

YARDSTICK = ("-c", "import torch")
EVERY_NAME = "import torchbrdf; [getattr(torchbrdf, name) for name in torchbrdf.__all__]"


def measured(arguments: tuple[str, ...], repeats: int) -> tuple[float, float]:
    """Median CPU and wall seconds of `python ARGUMENTS`, after one run that warms the disk's cache."""
    cpu, wall = [], []
    for _ in range(repeats + 1):
        before, start = os.times(), time.perf_counter()
        subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
        wall.append(time.perf_counter() - start)
        after = os.times()
        cpu.append(after.children_user + after.children_system - before.children_user - before.children_system)
    return statistics.median(cpu[1:]), statistics.median(wall[1:])


def main() -> None:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--repeats", type=int, default=5, help="of each; default: 5")
    repeats: int = parser.parse_args().repeats
    base, base_wall = measured(YARDSTICK, repeats)
    rows = [["`import torch`", "1.00", f"{base:.2f}", f"{base_wall:.2f}"]]

    def row(name: str, *arguments: str) -> None:
        cpu, wall = measured(arguments, repeats)
        rows.append([name, f"{cpu / base:.2f}", f"{cpu:.2f}", f"{wall:.2f}"])

    row("`import torchbrdf`", "-c", "import torchbrdf")
    row("`import torchbrdf`, and every public name", "-c", EVERY_NAME)
    for name in ("--version", "--help"):
        row(f"`torchbrdf {name}`", "-m", "torchbrdf.cli", name)
    for command in commands.found():
        row(f"`torchbrdf {command} --help`", "-m", "torchbrdf.cli", command, "--help")
    print(markdown_table(["", "ratio, CPU", "CPU, s", "wall, s"], rows))


if __name__ == "__main__":
    main()
