"""Results as rows of a file and as tables of a page."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

from torchbrdf.files import writing

BEGIN, END = "<!-- results: begin (written by the command above) -->", "<!-- results: end -->"


Rows = Sequence[dict[str, str]]


def write_rows(path: Path, rows: Sequence[Mapping[str, object]]) -> None:
    """Write rows as .csv, with the columns of the first."""
    with writing(path) as temporary, open(temporary, "w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def read_rows(path: Path) -> list[dict[str, str]]:
    """What `write_rows` wrote, as texts."""
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def percent(value: float) -> str:
    """A fraction with two decimals of a per cent."""
    return f"{100 * value:.2f}"


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table whose first column is text and whose others are numbers."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def check_document(path: Path) -> None:
    """Raise where `write_report` could not replace a part of this Markdown file."""
    text = path.read_text()
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise ValueError(f"{path}: needs one line {BEGIN!r} and, below it, one {END!r}")


def replace_results(path: Path, body: str) -> None:
    """Put a text between the markers of a Markdown file."""
    head, rest = path.read_text().split(BEGIN)
    with writing(path) as temporary:
        temporary.write_text(f"{head}{BEGIN}\n\n{body}\n{END}{rest.split(END)[1]}")
