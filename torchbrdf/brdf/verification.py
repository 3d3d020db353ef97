"""What tables are: sound or not, of which kind, how large, how whole, and which are one measurement."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf.brdf._remarks import brightness, holes
from torchbrdf.brdf.albedo import ALBEDO_DEG, MUCH_ALBEDO, directional_albedo
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.members import Member, as_list, library_members
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.brdf.merl_directory import MERL_MATERIALS
from torchbrdf.brdf.merl_grid import N_CELLS
from torchbrdf.brdf.sameness import same_measurements, sampled_cells
from torchbrdf.brdf.settings import EMBEDDED
from torchbrdf.brdf.tables import read_table
from torchbrdf.progress import progress_bar


@dataclass(frozen=True)
class VerifiedTable:
    """A sound table.

    name         in a library
    kind         "MERL", "RGL", "fit" for a result of `torchbrdf fit`, or "embedded"
    least, most  of f_r in 1/sr over the measured cells
    holes        share of the cells above the horizon that were not measured
    albedo       (4, 3) share of light from `ALBEDO_DEG` that is reflected in R, G, B
    """

    name: str
    kind: str
    least: float
    most: float
    holes: float
    albedo: Tensor

    def __str__(self) -> str:
        """One line."""
        angle = ALBEDO_DEG[int(self.albedo.amax(1).argmax())]
        return (
            f"{self.name}: {self.kind}, f_r {self.least:.3g} to {self.most:.3g} 1/sr, measured {1 - self.holes:.1%}, "
            f"reflects at most {float(self.albedo.max()):.1%} (at {angle}°)"
        )

    @property
    def remarks(self) -> tuple[str, ...]:
        """What it is to be warned of."""
        return tuple(filter(None, (brightness(self.albedo, MUCH_ALBEDO), holes(1 - self.holes))))


@dataclass(frozen=True)
class Verification:
    """What `verify` found: where, the sound tables, what is wrong with others, equal ones, missing MERL materials."""

    folders: tuple[Path, ...]
    tables: tuple[VerifiedTable, ...]
    unsound: dict[str, str]
    same: tuple[tuple[str, str], ...]
    missing: tuple[str, ...]

    @property
    def sound(self) -> tuple[str, ...]:
        """The names of the sound ones."""
        return tuple(table.name for table in self.tables)


def verify(sources: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], progress: bool = False) -> Verification:
    """Read all tables of folders and files, as `MaterialLibrary.from_files` takes and names them; say what they are.

    Raises as `library_members`. Tables that are not sound are named in what it returns.
    """
    embedded = MaterialLibrary.default(progress) if EMBEDDED in as_list(sources) else None
    members = library_members(sources, embedded.names if embedded else ())
    tables, values, measured, unsound, cells = [], [], [], dict[str, str](), sampled_cells()
    for member in progress_bar(members, desc="reading", shown=progress):
        try:
            table = _table(member, embedded)
        except (OSError, ValueError) as error:
            unsound[member.name] = str(error)
            continue
        tables.append(_verified(member, table))
        values.append(table.filled[cells].double())
        measured.append(table.valid.reshape(N_CELLS)[cells])
    same = same_measurements(torch.cat(values, 1), torch.stack(measured)) if tables else []
    stems = {member.path.stem for member in members if member.path is not None}
    return Verification(
        tuple(dict.fromkeys(member.path.parent for member in members if member.path is not None)),
        tuple(tables),
        unsound,
        tuple((tables[i].name, tables[j].name) for i, j in same if {tables[i].kind, tables[j].kind} != {"embedded"}),
        tuple(name for name in MERL_MATERIALS if name not in stems),
    )


def _table(member: Member, embedded: MaterialLibrary | None) -> MerlTable:
    if member.path is not None:
        return read_table(member.path)
    assert embedded is not None
    return embedded.table(member.name.removeprefix(f"{EMBEDDED}/"))


def _verified(member: Member, table: MerlTable) -> VerifiedTable:
    least, most = (float(value) for value in table.values[table.valid].aminmax())
    return VerifiedTable(member.name, member.kind, least, most, 1 - table.measured_share, directional_albedo(table))
