#!/usr/bin/env python3
"""Notebooks of the tutorials: run every cell of a page NAME.md in docs/tutorials, and write NAME.ipynb and NAME.png.

    python scripts/make_notebooks.py                  # after pages were changed: all of them, in two to four minutes
    python scripts/make_notebooks.py photographs      # one
    python scripts/make_notebooks.py --prose          # after changes to prose alone: cells keep their outputs
    python scripts/make_notebooks.py --check          # as CI does: run all, and compare, but write nothing

A page is a MyST text notebook: prose and cells. Cells run in an empty folder that stands where docs/tutorials does in
the clone, so that `%cd ../..` leads to its root; nothing is written into the clone. NAME.png is the picture of the cell
that is tagged `cover`. The documentation shows the notebooks as they are, so building it runs nothing.
"""

import argparse
import base64
import os
import re
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jupytext

from torchbrdf.command_line import Parser, exit_status
from torchbrdf.files import writing

ROOT = Path(__file__).resolve().parent.parent
PAGES = ROOT / "docs" / "tutorials"
FAILED = 1
"""Exit status."""

LARGEST = 400_000
"""Bytes of a notebook."""

COVER = "cover"
"""Tag of the cell whose picture stands for the page."""

_SECONDS = 300
"""That a cell may take."""

_PROGRESS = re.compile(r"\d%\|.*\|")
_PLACE = re.compile(r"\S*ipykernel_\d+\S*?:\d+: ")
_COLOUR = re.compile(r"\x1b\[[\d;]*m")
"""A bar that was not wiped out, where in a cell a warning arose, and what makes terminals colour text."""


def pages(names: Sequence[str] = (), folder: Path = PAGES) -> list[Path]:
    """The text notebooks of a folder, all or those of these names; raises ValueError where one is not there."""
    found = {path.stem: path for path in sorted(folder.glob("*.md")) if path.stem != "index"}
    unknown = [name for name in names if name not in found]
    if unknown:
        raise ValueError(f"{folder}: no tutorial {unknown[0]!r}; there are {', '.join(found)}")
    return [found[name] for name in names or found]


def read_page(path: Path) -> Any:
    """The notebook of a page, without outputs; numbers for ids, so that the same page is the same notebook."""
    notebook = jupytext.read(path, fmt="md:myst")
    for i, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{i}"
    return _plain(notebook)


def _plain(notebook: Any) -> Any:
    """The notebook with metadata that tell nothing of the machine it ran on."""
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    language = {"name": "python", "pygments_lexer": "ipython3"}
    notebook.metadata = type(notebook.metadata)(kernelspec=kernel, language_info=language)
    return notebook


def difference(page: Path) -> str | None:
    """How the notebook beside a page differs from it, in a line; None where its cells are the page's."""
    path = page.with_suffix(".ipynb")
    if not path.exists():
        return f"{path.name} is missing"
    theirs, ours = jupytext.read(path).cells, read_page(page).cells
    for i, (cell, own) in enumerate(zip(theirs, ours, strict=False)):
        if (cell.cell_type, cell.source) != (own.cell_type, own.source):
            return f"{path.name} differs from {page.name} in cell {i}: {own.source.splitlines()[0]}"
    if len(theirs) != len(ours):
        return f"{path.name} has {len(theirs)} cells, {page.name} {len(ours)}"
    if any(cell.cell_type == "code" and cell.execution_count is None for cell in theirs):
        return f"{path.name} was not run"
    return None


def retold(page: Path) -> Any:
    """The notebook of a page with the outputs of the one beside it; raises ValueError where their code differs."""
    path = page.with_suffix(".ipynb")
    notebook, old = read_page(page), jupytext.read(path) if path.exists() else None
    ran = [] if old is None else [cell for cell in old.cells if cell.cell_type == "code"]
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    if [cell.source for cell in ran] != [cell.source for cell in cells]:
        raise ValueError(f"{path.name}: its code is not that of {page.name}; run it without --prose")
    for cell, one in zip(cells, ran, strict=True):
        cell.execution_count, cell.outputs = one.execution_count, one.outputs
    return notebook


def executed(page: Path, clone: Path = ROOT) -> Any:
    """The notebook of a page with the outputs of its cells, run in a folder that is removed afterwards.

    Raises `nbclient.exceptions.CellExecutionError` where a cell fails.
    """
    import nbclient  # with its kernel it takes a second

    notebook = read_page(page)
    with tempfile.TemporaryDirectory() as temporary:
        work = os.path.realpath(temporary)
        folder = Path(work) / "docs" / "tutorials"
        folder.mkdir(parents=True)
        (Path(work) / "scripts").symlink_to(clone / "scripts")
        nbclient.NotebookClient(
            notebook, timeout=_SECONDS, kernel_name="python3", resources={"metadata": {"path": str(folder)}}
        ).execute(env={**os.environ, "PATH": _path()})
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        if "outputs" in cell:
            cell.outputs = as_on_a_terminal(cell.outputs, work)
    return _plain(notebook)


def as_on_a_terminal(outputs: Sequence[Any], work: str) -> list[Any]:
    """Outputs of a cell with what it wrote in one piece, without progress bars and the folder where it ran."""
    kept: list[Any] = []
    for output in outputs:
        if output.output_type == "stream" and kept and kept[-1].get("name") == output.name:
            kept[-1].text += output.text
        else:
            kept.append(output)
    for output in kept:
        if output.output_type == "stream":
            text = re.sub(re.escape(work) + "(/docs/tutorials)?/?", "", _COLOUR.sub("", output.text))
            text = _PLACE.sub("", text)
            lines = (line.rstrip().rsplit("\r", 1)[-1] for line in text.split("\n"))
            output.text = "".join(f"{line}\n" for line in lines if line and not _PROGRESS.search(line))
    return [output for output in kept if output.output_type != "stream" or output.text]


def _path() -> str:
    """PATH, with the programs of this Python first: they are what a page's commands mean."""
    return os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)])


def cover(notebook: Any) -> bytes | None:
    """The PNG file of the cell that is tagged `cover`."""
    found = [
        output["data"]["image/png"]
        for cell in notebook.cells
        if COVER in cell.metadata.get("tags", ())
        for output in cell.get("outputs", ())
        if "image/png" in output.get("data", {})
    ]
    return base64.b64decode(found[-1]) if found else None


def write_notebook(notebook: Any, page: Path) -> None:
    """NAME.ipynb, and NAME.png where there is a cover; raises ValueError where it is too large to keep."""
    text = jupytext.writes(notebook, fmt="ipynb")
    if len(text) > LARGEST:
        raise ValueError(f"{page.stem}.ipynb has {len(text)} bytes, at most {LARGEST}: show smaller pictures, or fewer")
    with writing(page.with_suffix(".ipynb")) as temporary:
        temporary.write_text(text)
    picture = cover(notebook)
    if picture is not None:
        with writing(page.with_suffix(".png")) as temporary:
            temporary.write_bytes(picture)


def run(options: argparse.Namespace) -> int:
    """Run the pages, each to its end or its first failing cell."""
    from nbclient.exceptions import CellExecutionError, DeadKernelError

    failed = []
    for page in pages(options.names, options.folder):
        start = time.monotonic()
        problem = difference(page) if options.check else None
        try:
            notebook = retold(page) if options.prose else executed(page)
            if not options.check:
                write_notebook(notebook, page)
        except (CellExecutionError, DeadKernelError) as error:
            problem = str(error)
        print(f"{page.stem}: {time.monotonic() - start:.0f} s", flush=True)
        if problem:
            print(f"{page.stem}: {problem}", flush=True)
            failed.append(page.stem)
    if failed:
        print(f"failed: {', '.join(failed)}" + ("; run it without --check, and look" if options.check else ""))
    return FAILED if failed else 0


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="of pages NAME.md; default: all")
    parser.add_argument("--folder", type=Path, default=PAGES, help="of the pages; default: docs/tutorials")
    either = parser.add_mutually_exclusive_group()
    either.add_argument("--prose", action="store_true", help="run nothing, keep the outputs")
    either.add_argument("--check", action="store_true", help="run and compare, write nothing")
    return exit_status("make_notebooks", run, parser.parse_args(argv), "interrupted; finished notebooks were kept")


if __name__ == "__main__":
    sys.exit(main())
