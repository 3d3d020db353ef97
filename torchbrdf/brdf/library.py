"""The material library: names, and the columns of B [CBP21, eq. 1]."""

import hashlib
import os
import warnings
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from torchbrdf.arguments import warn_of_lost_gradient
from torchbrdf.brdf._combination import combined
from torchbrdf.brdf._library_building import build_in_memory
from torchbrdf.brdf.column_sources import EmbeddedSource, MerlSource, StampedSource, TableSource
from torchbrdf.brdf.library_cache import MIXTURE, open_or_build
from torchbrdf.brdf.members import Member, as_list, check_different, library_members, position_among
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.brdf.merl_directory import table_paths
from torchbrdf.brdf.merl_grid import GRID, N_CELLS, above_horizon
from torchbrdf.brdf.settings import EMBEDDED
from torchbrdf.brdf.stored_columns import ROW_CELLS, StoredColumns, columns_of, shared_cells, unpacked
from torchbrdf.files import cache_folder

MIN_MATERIALS = 8
"""The fewest materials `from_merl` and `from_files` accept: fewer span no space of BRDFs."""

_NAMED = 3
"""Of many that are alike, in a message."""


@dataclass(frozen=True, eq=False, repr=False)
class MaterialLibrary:
    """m measured materials as n = 3 m basis BRDFs, one a colour channel.

    stored     the columns of all materials in the cache
    materials  which of them belong to this library, in order
    """

    stored: StoredColumns
    materials: tuple[int, ...]

    @classmethod
    def default(cls, progress: bool = True) -> "MaterialLibrary":
        """The embedded library of 116 materials: encoded, and expanded into a cache on first use."""
        folder = cache_folder() / "libraries" / "default"
        return cls._whole(open_or_build(EmbeddedSource(), folder, progress, known=None))

    @classmethod
    def from_merl(cls, directory: str | os.PathLike[str], progress: bool = True) -> "MaterialLibrary":
        """The library of the `table_paths` of a directory, as `from_files`; raises as both."""
        table_paths(directory)
        return cls.from_files(directory, progress)

    @classmethod
    def from_files(
        cls,
        sources: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
        progress: bool = True,
        without: Sequence[str] = (),
    ) -> "MaterialLibrary":
        """Measured tables of folders and files, of any format that is read, and "default", the embedded library.

        Folders that `torchbrdf fit` wrote count as their table. Materials are named after their files, with as many
        folders before that as keep them apart: `own/brass` beside `default/brass`. At least 8 altogether, converted
        once to a cache that is memory-mapped after; what another cache holds is taken from there.
        without leaves out some, as the method does, but gives back the cells that holes of theirs cost the others.
        Warns, whenever it is opened, of tables that are one measurement, of one that stays where the other is left out,
        of such as reflect nothing or twice what they get or more, or measured few cells, and of what reading them
        warned of. Raises OSError or ValueError as `library_members`, and where a table is unsound or no cell was
        measured in all.
        """
        given = as_list(sources)
        if set(given) == {EMBEDDED}:
            return cls.default(progress).without(*without)
        known = [cls.default(progress).stored] if EMBEDDED in given else []
        members = library_members(given, known[0].names if known else ())
        tables = [member.path for member in members if member.path is not None]
        folder = tables[0].parent if len(given) == 1 and Path(given[0]).is_dir() else None
        where = ", ".join(given) if folder is None else str(folder)
        _check_enough(len(members), where, f'add MERL *.binary files, or name "{EMBEDDED}" too')
        if folder is not None and _is_plain(members):
            resolved = folder.resolve()
            key = hashlib.sha256(os.fsencode(resolved)).hexdigest()[:12]
            source = MerlSource(tables, [member.name for member in members])
            stored = open_or_build(source, cache_folder() / "libraries" / f"{resolved.name}-{key}", progress)
            library = cls._whole(stored).without(*without)
        else:
            library = cls._of_members(members, progress, known).without(*without)
        if without and library._is_cut_by_others:
            used = set(library.names)
            library = cls._of_members([member for member in members if member.name in used], progress, known)
        return library._checked([member.name for member in members if member.path is None])

    @classmethod
    def _of_members(
        cls, members: Sequence[Member], progress: bool, known: Sequence[StoredColumns]
    ) -> "MaterialLibrary":
        """Of files and, where it is known, the embedded library."""
        tables = {member.name: member.path for member in members if member.path is not None}
        stamps = dict(zip(known[0].names, known[0].stamps, strict=True)) if known else {}
        held = {one.name: stamps[one.name.removeprefix(f"{EMBEDDED}/")] for one in members if one.path is None}
        mixed = StampedSource([one.name for one in members], held, MerlSource(list(tables.values()), list(tables)))
        places = [str(member.path.resolve()) if member.path else member.name for member in members]
        return cls._mixture(mixed, places, progress, known)

    @classmethod
    def _mixture(
        cls, source: StampedSource, places: Sequence[str], progress: bool, known: Sequence[StoredColumns]
    ) -> "MaterialLibrary":
        """The cache of what lies in these places, in this order."""
        key = hashlib.sha256(repr(places).encode()).hexdigest()[:12]
        return cls._whole(open_or_build(source, cache_folder() / "libraries" / f"{MIXTURE}{key}", progress, known))

    def __add__(self, other: "MaterialLibrary") -> "MaterialLibrary":
        """The materials of both, whose names must differ; in the cache where both are.

        Columns are copied, not computed anew.
        """
        if not isinstance(other, MaterialLibrary):
            return NotImplemented
        twice = sorted(set(self.names) & set(other.names))
        if twice:
            raise ValueError(
                f"both libraries have {', '.join(twice[:_NAMED])}{', ...' if len(twice) > _NAMED else ''}; take them "
                "out of one with without(...), or open the files together: MaterialLibrary.from_files keeps names apart"
            )
        known = [replace(part.stored, stamps=part._stamps_of_all) for part in (self, other)]
        held = {
            name: stored.stamps[i]
            for stored, part in zip(known, (self, other), strict=True)
            for name, i in zip(part.names, part.materials, strict=True)
        }
        source = StampedSource(list(held), held, MerlSource([], []))
        if self.stored.mapping is None or other.stored.mapping is None:
            return self._whole(build_in_memory(source, known))
        return self._mixture(source, [*held.values(), *held], False, known)

    @property
    def _stamps_of_all(self) -> tuple[str, ...]:
        stored = self.stored
        return stored.stamps or tuple(f"{stored.fingerprint} {i}" for i in range(len(stored.names)))

    @property
    def _is_cut_by_others(self) -> bool:
        """Whether stored materials that it leaves out cost its Gram matrix a tenth of the cells or more."""
        valid = self.stored.valid
        return int(shared_cells(valid).sum()) < 0.9 * int(shared_cells(valid[list(self.materials)]).sum())

    def _checked(self, embedded: Collection[str] = ()) -> "MaterialLibrary":
        """Itself; warns of what is to be said of its tables, but of no two that are both embedded."""
        names, own = self.stored.names, set(self.names)
        for name, texts in zip(names, self.stored.said, strict=True):
            for text in texts if name in own else ():
                warnings.warn(f"{name}: {text}", UserWarning, stacklevel=3)
        pairs = [(one, two) for one in embedded for two in names if two.endswith("_rgb") and _bare(one) == _bare(two)]
        pairs += [(names[i], names[j]) for i, j in self.stored.same]
        each = {frozenset(pair): pair for pair in pairs}
        same = [pair for key, pair in each.items() if key <= own and not key <= set(embedded)]
        if same:
            some = ", ".join(f"{one} and {two}" for one, two in same[:_NAMED])
            more = f", and {len(same) - _NAMED} pairs more" if len(same) > _NAMED else ""
            text = f"the same measurement twice in this library, where it counts twice: {some}{more}; leave one out"
            warnings.warn(text, UserWarning, stacklevel=3)
        for pair in each.values():
            for out, kept in (pair, pair[::-1]):
                if kept in own and out not in own:
                    text = f"{out} is left out, but {kept} is the same measurement and stays; leave that out, too"
                    warnings.warn(text, UserWarning, stacklevel=3)
        return self

    @classmethod
    def from_tables(cls, tables: Sequence[MerlTable]) -> "MaterialLibrary":
        """A library of tables in memory (9 MB a material)."""
        if not tables:
            raise ValueError("a library needs at least one table, got none")
        return cls._whole(build_in_memory(TableSource(tables)))

    @classmethod
    def _whole(cls, stored: StoredColumns) -> "MaterialLibrary":
        check_different(stored.names)
        return cls(stored, tuple(range(len(stored.names))))

    def __repr__(self) -> str:
        """Size and first names."""
        names = ", ".join(self.names[:3]) + (", ..." if len(self) > 3 else "")
        return f"MaterialLibrary({len(self)} materials, n = {self.n}: {names})"

    def __len__(self) -> int:
        """The number of materials m."""
        return len(self.materials)

    @property
    def n(self) -> int:
        """The number of basis BRDFs, 3 a material."""
        return 3 * len(self.materials)

    @property
    def names(self) -> tuple[str, ...]:
        """The materials, in the order of the columns."""
        return tuple(self.stored.names[i] for i in self.materials)

    @property
    def source(self) -> str:
        """sha256 of the stored columns: libraries that share it differ at most in which materials they use."""
        return self.stored.fingerprint

    @property
    def column_index(self) -> Tensor:
        """(n,) int64: this library's columns among the stored ones."""
        return columns_of(self.materials)

    @property
    def gram(self) -> Tensor:
        """(n, n) float64: B^T B over the cells measured in every stored material."""
        return self.stored.gram[self.column_index][:, self.column_index]

    def position(self, name: str) -> int:
        """Where a material stands among the names. Raises ValueError with the closest name."""
        return position_among(self.names, name, f"in this library of {len(self)}")

    def to(self, device: torch.device | str) -> "MaterialLibrary":
        """The library with its columns on another device (9 MB a material), where `render_basis` then runs."""
        return replace(self, stored=replace(self.stored, columns=self.stored.columns.to(device), mapping=None))

    def without(self, *names: str) -> "MaterialLibrary":
        """The library less some materials (leave-one-out); shares the cache."""
        dropped = {self.position(name) for name in names}
        return self.subset([name for i, name in enumerate(self.names) if i not in dropped])

    def subset(self, names: Sequence[str]) -> "MaterialLibrary":
        """The library of some materials only, in the order given; shares the cache."""
        if not names:
            raise ValueError("a library needs at least one material, got none")
        check_different(names)
        return replace(self, materials=tuple(self.materials[self.position(name)] for name in names))

    def table(self, name: str) -> MerlTable:
        """One material as a table (float16 precision, relative 4.9e-4)."""
        material = self.materials[self.position(name)]
        columns = slice(3 * material, 3 * material + 3)
        values = self.stored.columns[:, columns].cpu().double() * self.stored.scale[columns]
        return MerlTable.of_filled(values.view(*GRID, 3), unpacked(self.stored.valid[material]).reshape(GRID), name)

    def combine(self, weights: Tensor, name: str = "combination") -> MerlTable:
        """The table rho = B w [CBP21, eq. 1], cells below zero set to zero.

        weights  (n, 3)  one column a colour channel of the result
        A cell counts as measured where every material with a weight measured it; without any weight f_r is 0. No
        gradient flows through it, of which it warns; for a loss under other light use `BasisImages.render`.
        """
        if weights.shape != (self.n, 3):
            raise ValueError(f"weights must be ({self.n}, 3) for this library, got {tuple(weights.shape)}")
        return self.combine_each(weights[None], [name])[0]

    def combine_each(self, weights: Tensor, names: Sequence[str], keep: bool = True) -> list[MerlTable]:
        """`combine` of K sets of weights (K, n, 3), in the time of little more than one: the columns are read once.

        keep  see `StoredColumns.blocks`
        """
        if weights.ndim != 3 or weights.shape != (len(names), self.n, 3):
            raise ValueError(
                f"weights must be ({len(names)}, {self.n}, 3) for these names and this library, "
                f"got {tuple(weights.shape)}"
            )
        instead = "for a loss under other light use basis.render(weights)"
        warn_of_lost_gradient(weights, "weights through a table", instead)
        weights = weights.detach().cpu().double()
        has_weight = (weights != 0).any(2)  # (K, n)
        used = torch.nonzero(has_weight.any(0)).ravel()
        values = combined(self.stored, self.column_index[used], weights[:, used], keep)
        tables, measured = [], dict[tuple[int, ...], tuple[Tensor, bool]]()
        for value, some, name in zip(values, has_weight, names, strict=True):
            materials = tuple(sorted({self.materials[i // 3] for i in torch.nonzero(some).ravel().tolist()}))
            if materials not in measured:
                measured[materials] = self._measured(materials)
            valid, filled = measured[materials]
            make = MerlTable.of_filled if filled else MerlTable
            tables.append(make(value.view(*GRID, 3), valid, name))
        return tables

    def _measured(self, materials: tuple[int, ...]) -> tuple[Tensor, bool]:
        """(90, 90, 180) bool: measured in all of some stored materials; and whether all are filled as one table is."""
        masks = self.stored.valid[list(materials)]
        return shared_cells(masks).reshape(GRID), len(masks) > 0 and bool((masks == masks[0]).all())

    def rows(self, cells: Tensor | slice, keep: bool = True) -> Tensor:
        """(N, n) float32: f_r of every basis BRDF in some cells; anything finite where it was not measured.

        keep  False: the columns leave the memory of this process; beside those of a few cells here and there the
              system maps what lies around them, 150 MB for 2,000
        """
        columns = self.column_index
        scale = self.stored.scale[columns].to(self.stored.columns.device, torch.float32)
        rows = self.stored.columns[cells].float()[:, columns] * scale
        if not keep:
            self.stored.release()
        return rows

    def map_rows(self, function: Callable[[Tensor], Tensor]) -> Tensor:
        """(90, 90, 180, 3) float32: what a function of the rows of B gives in every cell, a block of cells at a time.

        function  rows (N, n), see `rows` -> (N, 3)
        Cells below the horizon, which nothing can measure, are 0.
        """
        values, lit = torch.zeros(N_CELLS, 3, dtype=torch.float32), above_horizon().ravel()
        for start in range(0, N_CELLS, ROW_CELLS):
            cells = start + torch.nonzero(lit[start : start + ROW_CELLS]).ravel()
            values[cells] = function(self.rows(cells)).to(values)
        return values.reshape(*GRID, 3)


def _bare(name: str) -> str:
    """Without folders, and without what files of the RGL database add to it."""
    return name.rsplit("/", 1)[-1].removesuffix("_rgb")


def _is_plain(members: Sequence[Member]) -> bool:
    """Whether all are named as the tables of one folder are."""
    return all(member.path is not None and member.name == member.path.stem for member in members)


def _check_enough(count: int, where: str, remedy: str) -> None:
    if count < MIN_MATERIALS:
        raise ValueError(f"{where}: a library needs at least {MIN_MATERIALS} materials, found {count}; {remedy}")
