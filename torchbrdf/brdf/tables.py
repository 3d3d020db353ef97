"""A measured table from a file of any format that is read: MERL's, or the RGL database's."""

import os
from pathlib import Path

from torchbrdf.brdf.merl import MerlTable
from torchbrdf.brdf.settings import RGL_SUFFIX, TABLE_SUFFIXES
from torchbrdf.images import kind_by_suffix


def read_table(path: str | os.PathLike[str], isotropic: bool = False) -> MerlTable:
    """The table in a file: `.bsdf` of the RGL database, tabulated on MERL's grid, else MERL's `.binary` or `.fullbin`.

    isotropic  take the mean over all azimuths of a material that is not
    Raises as `MerlTable.from_bsdf` and `MerlTable.open`; ValueError for a picture.
    """
    path = Path(path)
    if path.suffix.lower() == RGL_SUFFIX:
        return MerlTable.from_bsdf(path, isotropic)
    if path.suffix.lower() not in TABLE_SUFFIXES and path.is_file() and (kind := kind_by_suffix(path)) is not None:
        raise ValueError(f"{path}: is a picture ({kind}), not a table; give one, {', '.join(TABLE_SUFFIXES)}")
    return MerlTable.open(path)
