"""Rows of the tables of speed: both versions side by side, what was asked for, kept between runs of some rows."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from torchbrdf.experiments import markdown_table, replace_results
from torchbrdf.files import writing

HEAD = ["", "times as fast", "now", "before", "to reach", "", "error now", "before", "peak MiB now", "before", ""]

MISSED = "**missed**"
FAILED = "**failed**: a command ended with an error"


@dataclass(frozen=True)
class Row:
    """What was measured, of this version and of its rival.

    now, before    seconds; None where a version cannot do it
    limit          seconds to reach; None where none was asked for
    accurate       the error to reach, and whether it is reached; None where none was asked for
    error_, peak_  beside them, in words; empty for none
    remark         what a reader has to know
    revision       of the version that was measured, and how often
    """

    what: str
    now: float | None = None
    before: float | None = None
    limit: float | None = None
    accurate: tuple[float, bool] | None = None
    error_now: str = ""
    error_before: str = ""
    peak_now: str = ""
    peak_before: str = ""
    remark: str = ""
    revision: str = ""

    @property
    def verdict(self) -> str:
        """Whether the limits are met; empty where none was asked for."""
        if self.limit is None or self.now is None:
            return ""
        if self.accurate is not None and not self.accurate[1]:
            return f"{MISSED}: error" if self.now <= self.limit else f"{MISSED}: both"
        return verdict(self.now, self.limit)

    def cells(self) -> list[str]:
        """As `HEAD` names them."""
        ratio = f"{self.before / self.now:.2f}" if self.now and self.before else ""
        limits = [] if self.limit is None else [f"<= {in_words(self.limit)}"]
        if self.accurate is not None:
            limits.append(f"<= {100 * self.accurate[0]:.2g}%")
        seconds = ["" if value is None else in_words(value) for value in (self.now, self.before)]
        errors, peaks = [self.error_now, self.error_before], [self.peak_now, self.peak_before]
        return [self.what, ratio, *seconds, ", ".join(limits), self.verdict, *errors, *peaks, self.remark]


def verdict(value: float, limit: float) -> str:
    """In a table."""
    return "met" if value <= limit else MISSED


def in_words(seconds: float) -> str:
    """With the unit that suits it, and three digits."""
    if seconds < 0.1:
        return f"{1e3 * seconds:.3g} ms"
    return f"{seconds:.2f} s" if seconds < 10 else f"{seconds:.1f} s" if seconds < 100 else f"{seconds:,.0f} s"


def kept(path: Path, fresh: Iterable[Row], order: Sequence[str]) -> list[Row]:
    """The rows of a file with those that are measured now in their places; each is written as soon as it is there.

    order  names of all rows that there are now; others are dropped
    """
    rows = {row["what"]: Row(**row) for row in (json.loads(path.read_text()) if path.is_file() else [])}
    for row in fresh:
        rows[row.what] = row
        with writing(path) as temporary:
            temporary.write_text(json.dumps([asdict(row) for row in rows.values()], indent=1) + "\n")
    return [rows[name] for name in order if name in rows]


def report(rows: Sequence[Row], about: str, now: str, before: str) -> str:
    """The table in Markdown, under a line about the machine.

    now, before  names of the versions
    """
    head = [title.replace("now", now).replace("before", before) for title in HEAD]
    missed = [row.what for row in rows if row.verdict.startswith(MISSED)]
    asked = sum(row.verdict != "" for row in rows)
    lines = [about, "", markdown_table(head, [row.cells() for row in rows]), ""]
    lines.append(f"Of {asked} figures that were asked for, {asked - len(missed)} are met.")
    lines += [f"**Failed**: {row.what}." for row in rows if row.remark == FAILED]
    revisions = {row.revision: [other.what for other in rows if other.revision == row.revision] for row in rows}
    if len(revisions) == 1:
        lines.append(f"Revision {rows[0].revision}.")
    else:
        lines += [f"Revision {revision}: {'; '.join(names)}." for revision, names in revisions.items()]
    return "\n".join(lines)


def publish(text: str, document: Path | None) -> None:
    """Print a text; put it between the markers of a page where one is given."""
    print(text)
    if document is not None:
        replace_results(document, text + "\n")
