"""The page of the gallery: figures by class, the worst, and a picture of every material with what is told of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import mean, median

import numpy as np
from scipy.stats import spearmanr

from torchbrdf.experiments import markdown_table

TITLES = ("diffuse and glossy", "plastics and phenolics", "metals and specular paints", "mirror-like coats")
"""Of the embedded library's classes."""

FOLDER, OVERVIEW = "figures/gallery", "overview"
_WORST = 12
_ACROSS = 2


@dataclass(frozen=True)
class Row:
    """What is told of a material.

    material, class_index
    left_out    materials that the library lacked, too
    neighbours  those nearest to it with how far they are, the nearest first
    stranger    how far the nearest was that the library did not lack
    fitted, error, delta_e  on the photograph, and of the picture under the studio light: |shown - true| / |true|, and
                            the mean of CIEDE2000
    exposure     of both pictures
    """

    material: str
    class_index: int
    left_out: tuple[str, ...]
    neighbours: tuple[tuple[str, float], ...]
    stranger: float
    fitted: float
    error: float
    delta_e: float
    exposure: float


def picture_name(material: str) -> str:
    """What the file of a material's picture is called, without suffix."""
    return material.replace("/", "-")


def ordered(rows: Sequence[Row]) -> list[Row]:
    """By class, the worst first."""
    return sorted(rows, key=lambda row: (row.class_index, -row.error))


def body(rows: Sequence[Row], titles: Sequence[str]) -> str:
    """Everything that is written anew: Markdown.

    titles  of the classes; those that it lacks have a number only
    """
    rows = ordered(rows)
    names = "every material of the library under the studio light, in the order of this page"
    parts = [
        f"![{len(rows)} balls: {names}]({FOLDER}/{OVERVIEW}.webp)",
        "## In figures\n\n" + _figures(rows, titles),
        f"### The worst {min(_WORST, len(rows))}\n\n" + _worst(rows),
    ]
    for index, members in _by_class(rows).items():
        parts.append(f"## {_title(index, titles)}\n\n" + _gallery(members))
    return "\n\n".join(parts)


def _by_class(rows: Sequence[Row]) -> dict[int, list[Row]]:
    return {i: [row for row in rows if row.class_index == i] for i in sorted({row.class_index for row in rows})}


def _title(index: int, titles: Sequence[str]) -> str:
    return f"Class {index}" + (f": {titles[index]}" if index < len(titles) else "")


def _percent(share: float) -> str:
    return f"{100 * share:.1f}" if share < 0.1 else f"{100 * share:.0f}"


def _figures(rows: Sequence[Row], titles: Sequence[str]) -> str:
    lines = []
    groups = {_title(index, titles).removeprefix("Class "): members for index, members in _by_class(rows).items()}
    for title, some in {**groups, "all": rows}.items():
        errors = [row.error for row in some]
        spread = (mean(errors), median(errors), float(np.quantile(errors, 0.9)), max(errors))
        colours = mean(row.delta_e for row in some)
        lines.append([title, str(len(some)), *map(_percent, spread), f"{colours:.1f}"])
    head = ["class", "materials", "mean %", "median", "90 %", "worst", "ΔE"]
    text = markdown_table(head, lines)
    if len(rows) > 2:
        correlation = spearmanr([row.stranger for row in rows], [row.error for row in rows]).statistic
        text += (
            "\n\nThe farther the nearest material that was left in the library, the larger the error: rank correlation "
            f"{correlation:.2f}."
        )
    return text


def _worst(rows: Sequence[Row]) -> str:
    worst = sorted(rows, key=lambda row: -row.error)[:_WORST]
    lines = [
        [row.material, _percent(row.error), f"{row.delta_e:.1f}", _percent(row.fitted), _percent(row.stranger)]
        for row in worst
    ]
    return markdown_table(["material", "error %", "ΔE", "fit %", "nearest %"], lines) + (
        "\n\nFit: the error on the photograph itself, with its noise. Nearest: how far the nearest material is, of "
        "those that the library kept."
    )


def _gallery(rows: Sequence[Row]) -> str:
    """Two materials a row: a picture, and below it the name, the error and the neighbours."""
    usual = max(row.exposure for row in rows)
    cells = [_cell(row, usual) for row in rows]
    while len(cells) % _ACROSS:
        cells.append("")
    lines = [cells[i : i + _ACROSS] for i in range(0, len(cells), _ACROSS)]
    head = ["truth and recovered"] * _ACROSS
    return "\n".join("| " + " | ".join(line) + " |" for line in (head, [":---:"] * _ACROSS, *lines))


def _cell(row: Row, usual: float) -> str:
    """Lines of their own keep the columns of a table equally wide."""
    alternative = f"{row.material}: the truth at the left, recovered at the right"
    dimmed = f", exposure\u00a0{row.exposure:g}" if row.exposure < usual else ""
    lines = [
        f"![{alternative}]({FOLDER}/{picture_name(row.material)}.webp)",
        f"**{_breakable(row.material)}**",
        f"{_percent(row.error)}\u00a0%, ΔE\u00a0{row.delta_e:.1f}{dimmed}",
    ]
    for name, far in row.neighbours:
        shown = _breakable(name)
        lines.append(f"{f'*{shown}*' if name in row.left_out else shown} {100 * far:.0f}\u00a0%")
    return "<br>".join(lines)


def _breakable(name: str) -> str:
    """A name that a narrow column may break after underscores, as after hyphens."""
    return name.replace("_", "_<wbr>")
