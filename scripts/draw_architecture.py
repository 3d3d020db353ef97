#!/usr/bin/env python3
"""Draw the rooms of the package and who imports from whom: docs/figures/architecture.svg.

    python scripts/draw_architecture.py            # writes the picture; needs Graphviz
    python scripts/draw_architecture.py --check    # fails where the picture is not that of the code; needs nothing

The order of the rooms is that of `[tool.importlinter]` in pyproject.toml. An arrow is an import in any module of a
room, also one inside a function; those that a longer way implies are left out. The picture holds what it was drawn
from.
"""

import argparse
import ast
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from html import escape
from itertools import pairwise
from pathlib import Path
from textwrap import wrap

from torchbrdf.command_line import Parser, exit_status
from torchbrdf.files import writing

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "torchbrdf"
PICTURE = ROOT / "docs" / "figures" / "architecture.svg"

_HEAD = """digraph {
  graph [rankdir=TB, nodesep=0.25, ranksep=0.35, bgcolor=white];
  node [shape=box, style="rounded,filled", fillcolor="#eef3f8", color="#9fb2c6", fontname=Helvetica];
  edge [color="#6b7785", arrowsize=0.6];"""


def layers() -> list[list[str]]:
    """The rooms from the highest layer down, as declared; without those that only this package's root knows."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layered = next(contract for contract in declared if contract["type"] == "layers")
    split = ([name.strip() for name in layer.split("|")] for layer in layered["layers"])
    rows = ([name for name in names if not name.startswith("_")] for names in split)
    return [row for row in rows if row]


def modules(room: str) -> list[Path]:
    """The files of a room."""
    folder = PACKAGE / room
    return sorted(folder.rglob("*.py")) if folder.is_dir() else [PACKAGE / f"{room}.py"]


def imported(room: str) -> set[str]:
    """The rooms from which a room imports."""
    found = set()
    for path in modules(room):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {name.name for name in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module == "torchbrdf":
                found |= {f"torchbrdf.{name.name}" for name in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                found.add(node.module)
    return {name.split(".")[1] for name in found if name.startswith("torchbrdf.")} - {room}


def arrows(rooms: Sequence[str]) -> list[tuple[str, str]]:
    """Imports between rooms, less those that a longer way implies."""
    uses = {room: imported(room) & set(rooms) for room in rooms}
    reached: dict[str, set[str]] = {}
    for room in reversed(rooms):  # from the lowest up: what is below is known
        reached[room] = uses[room].union(*(reached[other] for other in uses[room]))
    return [
        (room, other)
        for room in rooms
        for other in sorted(uses[room])
        if not any(other in reached[between] for between in uses[room])
    ]


def purpose(room: str) -> str:
    """The first sentence of a room's docstring, without its equation numbers."""
    folder = PACKAGE / room
    source = folder / "__init__.py" if folder.is_dir() else PACKAGE / f"{room}.py"
    text = (ast.get_docstring(ast.parse(source.read_text())) or "").splitlines()[0]
    return text.split(" [CBP21")[0].split(": ")[0].rstrip(".") + "."


def graph(rows: Sequence[Sequence[str]]) -> str:
    """The picture in the language of Graphviz: a row for each layer."""
    lines = [_HEAD]
    for row in rows:
        lines.append("  { rank=same; " + " ".join(f'"{room}";' for room in row) + " }")
        lines += [f'  "{room}" [label=<{label(room)}>];' for room in row]
    for above, below in pairwise(rows):  # keeps layers apart that no arrow ties
        lines.append(f'  "{above[0]}" -> "{below[0]}" [style=invis];')
    lines += [f'  "{room}" -> "{other}";' for room, other in arrows([room for row in rows for room in row])]
    return "\n".join([*lines, "}", ""])


def label(room: str) -> str:
    """The name of a room and, smaller, its purpose."""
    name = f"{room}/" if (PACKAGE / room).is_dir() else f"{room}.py"
    lines = "<br/>".join(escape(line) for line in wrap(purpose(room), 34))
    return f'<b>{name}</b><br/><font point-size="10" color="#4a5560">{lines}</font>'


def run(options: argparse.Namespace) -> None:
    """Write or check."""
    source = graph(layers())
    origin = f"<!-- drawn from\n{source.replace('--', '- -')}-->\n"
    if options.check:
        if not PICTURE.is_file() or not PICTURE.read_text().endswith(origin):
            raise ValueError(f"{PICTURE.relative_to(ROOT)} is not the picture of this code; run {sys.argv[0]}")
        return
    drawn = subprocess.run(["dot", "-Tsvg"], input=source, capture_output=True, text=True, check=True).stdout
    with writing(PICTURE) as temporary:
        temporary.write_text(drawn + origin)


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit status 2 where the picture is stale")
    return exit_status("draw_architecture", run, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
