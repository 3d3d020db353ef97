"""weights.json of a result: what tells how its table was made."""

import json
from collections.abc import Mapping
from pathlib import Path

from torchbrdf.brdf import RESULT, RESULT_STD
from torchbrdf.files import writing

WEIGHTS = "weights.json"
"""Written last: where it is, the others are whole."""


def write_weights(folder: Path, record: Mapping[str, object]) -> None:
    """Write weights.json."""
    with writing(folder / WEIGHTS) as path:
        path.write_text(json.dumps(record, indent=1) + "\n")


def primaries_of(table: Path) -> str | None:
    """The linear RGB that a table of `torchbrdf fit` is in, as weights.json beside it says; None of any other table."""
    if table.name not in (RESULT, RESULT_STD):
        return None
    try:
        found = json.loads((table.parent / WEIGHTS).read_text())["primaries"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return found if isinstance(found, str) else None
