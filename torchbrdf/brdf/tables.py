"""A measured table from a file of any format that is read: MERL's, or the RGL database's."""

import os
from pathlib import Path

from torchbrdf.brdf.merl import MerlTable
from torchbrdf.brdf.settings import RGL_SUFFIX


def read_table(path: str | os.PathLike[str], isotropic: bool = False) -> MerlTable:
    """The table in a file: `.bsdf` of the RGL database, tabulated on MERL's grid, else MERL's `.binary` or `.fullbin`.

    isotropic  take the mean over all azimuths of a material that is not
    Raises as `MerlTable.from_bsdf` and `MerlTable.open`.
    """
    if Path(path).suffix.lower() == RGL_SUFFIX:
        return MerlTable.from_bsdf(path, isotropic)
    return MerlTable.open(path)
