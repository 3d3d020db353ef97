"""What `torchbrdf verify` says of a measured table."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import radians

import torch
from torch import Tensor
from tqdm import tqdm

from torchbrdf.brdf import GRID, N_CELLS, RESULT, RGL_SUFFIX, Member, MerlTable, read_table, same_values, shared_sample
from torchbrdf.estimation import albedo_rule

_ANGLES_DEG = (0, 15, 30, 45, 60, 75)
TOO_MUCH = 1.02
"""Directional albedo above which a table reflects more than it gets: the rule of cells is good to a per cent."""

FAR_TOO_MUCH = 2.0
"""Above which its scale is in doubt: another unit, or a factor of pi or 1500."""


@dataclass(frozen=True)
class Inspected:
    """A sound table.

    kind      its format
    range     least and largest f_r, 1/sr
    holes     share of the cells above the horizon that were not measured
    albedo    the largest directional albedo of a channel, and at which angle of the light it is, in degrees
    sampled   (N, 3)  f_r in the cells of `shared_sample`
    """

    name: str
    stem: str
    kind: str
    range: tuple[float, float]
    holes: float
    albedo: tuple[float, int]
    sampled: Tensor

    def __str__(self) -> str:
        """One line."""
        most, angle = self.albedo
        return (
            f"{self.name}: {self.kind}, f_r {self.range[0]:.3g} to {self.range[1]:.3g} 1/sr, "
            f"{self.holes:.1%} not measured, reflects at most {most:.1%} (at {angle}°)"
        )


def inspected(members: Sequence[Member], progress: bool = False) -> tuple[list[Inspected], dict[str, str]]:
    """The sound tables, and of the others what is wrong."""
    sound, unsound = [], {}
    for member in tqdm(members, desc="reading", disable=not progress, leave=False):
        if member.path is None:
            continue
        try:
            table = read_table(member.path)
        except (OSError, ValueError) as error:
            unsound[member.name] = str(error)
            continue
        rgl = member.path.suffix.lower() == RGL_SUFFIX
        fitted = member.path.name == RESULT
        kind = "RGL" if rgl else "a fit on MERL's grid" if fitted else "MERL"
        kind += " tabulated on" if rgl else "" if fitted else ","
        sound.append(_of(table, member.name, member.path.stem, f"{kind} {' x '.join(map(str, GRID))}"))
    return sound, unsound


def _of(table: MerlTable, name: str, stem: str, kind: str) -> Inspected:
    measured = table.values[table.valid]
    albedo, angle = largest_albedo(table)
    sampled = table.filled[shared_sample()].double()
    least, most = float(measured.min()), float(measured.max())
    return Inspected(name, stem, kind, (least, most), 1 - table.measured_share, (albedo, angle), sampled)


def largest_albedo(table: MerlTable) -> tuple[float, int]:
    """The most that a channel reflects of light from one angle, and that angle in degrees."""
    filled = table.filled.double().reshape(N_CELLS, 3)
    albedo = torch.stack([(weights @ filled[cells]).amax() for cells, weights in _rules()])
    return float(albedo.max()), _ANGLES_DEG[int(albedo.argmax())]


@lru_cache(maxsize=1)
def _rules() -> list[tuple[Tensor, Tensor]]:
    return [albedo_rule(radians(angle)) for angle in _ANGLES_DEG]


def remarks(tables: Sequence[Inspected]) -> list[str]:
    """Of those that reflect more light than they get."""
    said = []
    for table in tables:
        most, angle = table.albedo
        if most > TOO_MUCH:
            advice = "" if most < FAR_TOO_MUCH else "; is it of another scale? divide it, or leave it out"
            said.append(f"{table.name} reflects {most:.3g} times the light that comes in at {angle}°{advice}")
    return said


def one_measurement(tables: Sequence[Inspected]) -> list[str]:
    """Of pairs that are equal but for one factor."""
    if not tables:
        return []
    pairs = same_values([table.sampled for table in tables], [table.name for table in tables])
    return [f"{one} and {two} are one measurement" for one, two in pairs]
