#!/usr/bin/env python3
"""Write docs/warnings.md from the words that the report itself has, so that both say the same.

    python scripts/write_warnings.py
    python scripts/write_warnings.py --check
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill

from torchbrdf.command_line import Parser, exit_status
from torchbrdf.files import writing
from torchbrdf.report.advice import ADVICE, TOPICS, Topic
from torchbrdf.report.grade import HARMLESS

PAGE = Path(__file__).resolve().parents[1] / "docs" / "warnings.md"
WIDTH = 120

HEAD = """\
# What the warnings mean

`torchbrdf fit` warns on the terminal, and its report has a paragraph for each warning; here are all of them. What the
report's grades stand for, and how often they are right, is [measured](uncertainty.md#the-reports-grade). What a good
result may have, too, is said there as a note, and so marked here. In Python
[`torchbrdf.report.doubts_of_result`](api/reports.md) gives those about a result.
`scripts/write_warnings.py` makes this page from the words of the report, `torchbrdf/report/advice.py`.
"""

NOTE = "A note on the terminal: the result is no worse for it."


def paragraph(topic: Topic) -> str:
    """A section of the page."""
    advice = ADVICE[topic]
    parts = (*([NOTE] if topic in HARMLESS else []), advice.meaning, advice.remedy)
    words = (fill(text, WIDTH, break_on_hyphens=False, break_long_words=False) for text in parts)
    more = f"More: [{advice.heading}]({advice.page}). In Python its `topic` is `{topic}`."
    return "\n\n".join([f"## {advice.title}", *words, more])


def page() -> str:
    """All of it."""
    return "\n".join([HEAD, "\n\n".join(map(paragraph, TOPICS)), ""])


def run(options: argparse.Namespace) -> None:
    """Write or check."""
    if options.check:
        if not PAGE.is_file() or PAGE.read_text() != page():
            stale = "says something else than torchbrdf/report/advice.py"
            raise ValueError(f"{PAGE.name} {stale}; run scripts/write_warnings.py")
        return
    with writing(PAGE) as temporary:
        temporary.write_text(page())


def main(argv: Sequence[str] | None = None) -> int:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit status 2 where the page is stale")
    return exit_status("write_warnings", run, parser.parse_args(argv))


if __name__ == "__main__":
    sys.exit(main())
