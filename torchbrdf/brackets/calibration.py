"""What two merged pictures must share to have one scale, as the attributes of an .exr file keep it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np

from torchbrdf.brackets._raw import Development
from torchbrdf.brackets.response import GRID, Curve
from torchbrdf.images import DECODERS, ColourSpace, Transfer, read_metadata

ATTRIBUTE = "torchbrdf:merge"
_VERSION = 1


@dataclass(frozen=True)
class Calibration:
    """How integers became radiance.

    curve        the response
    stops        whether times and apertures were taken at the stops that files round
    unit         of radiance
    primaries    the colour space of the picture
    camera       maker and model; empty where not known
    kind         of the files, such as "8-bit JPEG"
    development  for camera RAW
    """

    curve: Curve
    stops: bool
    unit: str
    primaries: ColourSpace
    camera: str = ""
    kind: str = ""
    development: Development | None = None

    @classmethod
    def read(cls, path: Path) -> Calibration:
        """That of a picture that was merged; raises ValueError where the file says none."""
        text = read_metadata(path).get(ATTRIBUTE)
        if text is None:
            raise ValueError(f"{path}: does not say how it was merged; --like takes an .exr file of `torchbrdf merge`")
        try:
            said = json.loads(text)
            if said["version"] != _VERSION or said["primaries"] not in get_args(ColourSpace):
                raise ValueError
            curves = said["curves"]
            known = None if curves else _named(said["response"])
            values = np.array(curves, dtype=float) if curves else None
            if values is not None and (values.shape != (3, GRID) or not (np.diff(values) > 0).all()):
                raise ValueError
            return cls(
                Curve(said["response"], known, values),
                bool(said["stops"]),
                str(said["unit"]),
                said["primaries"],
                str(said["camera"]),
                str(said["kind"]),
                Development.of(said["development"]) if said["development"] else None,
            )
        except (ValueError, LookupError, TypeError):
            raise ValueError(
                f"{path}: what it says of its merging ({ATTRIBUTE}) is of another version; merge it again"
            ) from None

    def text(self) -> str:
        """What `read` reads."""
        values = self.curve.values
        return json.dumps(
            {
                "version": _VERSION,
                "response": self.curve.name,
                "curves": None if values is None else [[float(f"{v:.6g}") for v in row] for row in values],
                "stops": self.stops,
                "unit": self.unit,
                "primaries": self.primaries,
                "camera": self.camera,
                "kind": self.kind,
                "development": None if self.development is None else vars(self.development),
            }
        )


def _named(name: str) -> Transfer:
    """The curve of this name; raises ValueError where a file's own profile held it."""
    known = {transfer.name: transfer for transfer in DECODERS.values()}
    if name.startswith("gamma "):
        return Transfer.power(float(name.removeprefix("gamma ")))
    return known[name]
