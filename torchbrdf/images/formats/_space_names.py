"""Colour spaces by the names that programs write into files beside or in place of primaries."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchbrdf.arguments import warn
from torchbrdf.files import printable
from torchbrdf.images.primaries import SPACES, Primaries
from torchbrdf.images.settings import ColourSpace

SPACE_KEYS = ("colorInteropID", "oiio:ColorSpace", "colorspace")
"""Attributes that hold a name: of the Color Interop Forum, OpenImageIO, others; the first that says anything counts."""

_SAY_NOTHING = {"", "linear", "lin", "scenelinear", "rolescenelinear", "raw", "data", "noncolor", "unknown", "none"}

_PREFIX = re.compile(r"(?:aces|utility)(?=lin|acescg|aces20651)")
"""Of names in ACES's configurations of OpenColorIO: "ACES - ACEScg"."""

_SPACES_BY_NAME: dict[str, ColourSpace] = {
    "linrec709": "rec709",
    "linsrgb": "rec709",
    "linrec709srgb": "rec709",
    "linrec2020": "rec2020",
    "linp3d65": "p3-d65",
    "linap0": "aces-ap0",
    "aces20651": "aces-ap0",
    "linap1": "aces-ap1",
    "acescg": "aces-ap1",
}


def space_named(path: Path, header: Mapping[str, Any]) -> Primaries | None:
    """The linear space that a file's attributes name; None where they name none.

    Warns of a name that is none of a linear space that is known, as those of encodings are.
    """
    for key in SPACE_KEYS:
        said = header.get(key, "")
        if not isinstance(said, str):
            continue
        name = re.sub(r"[\W_]+", "", said.casefold())
        if name in _SAY_NOTHING:
            continue
        space = _SPACES_BY_NAME.get(_PREFIX.sub("", name).replace("linear", "lin", 1).removesuffix("scene"))
        if space is not None:
            return SPACES[space]
        warn(
            f"{path}: says that its colours are {printable(said)!r} ({key}), no linear space that is known here; taken "
            "as linear Rec. 709: where they are not, convert the file to that, or to ACEScg"
        )
        return None
    return None
