"""Columns that a library need not compute, as other libraries have stored them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from torchbrdf.brdf.column_sources import columns_of, shared_cells
from torchbrdf.brdf.gram import lower_gram

_LOST_DIGITS = 1e-5
"""Of a diagonal of the Gram matrix: where less is left after a subtraction, the sum is taken anew."""


@dataclass(frozen=True)
class Part:
    """Materials of a library that are those of an earlier one, with the same columns.

    fingerprint  of the earlier library
    theirs       positions there
    mine         positions in the library that holds the part
    """

    fingerprint: str
    theirs: tuple[int, ...]
    mine: tuple[int, ...]


class Stored(Protocol):
    """See `StoredColumns`."""

    @property
    def columns(self) -> Tensor: ...
    @property
    def scale(self) -> Tensor: ...
    @property
    def gram(self) -> Tensor: ...
    @property
    def valid(self) -> Tensor: ...
    @property
    def fingerprint(self) -> str: ...
    @property
    def stamps(self) -> tuple[str, ...]: ...
    @property
    def parts(self) -> tuple[Part, ...]: ...
    def release(self) -> None: ...


@dataclass(frozen=True)
class Reused:
    """Materials of a library to build, and where they are stored."""

    stored: Stored
    theirs: tuple[int, ...]
    mine: tuple[int, ...]

    @property
    def parts(self) -> list[Part]:
        """By the libraries that the stored one itself was made from, if it was."""
        mine = dict(zip(self.theirs, self.mine, strict=True))
        parts = []
        for part in self.stored.parts or [Part(self.stored.fingerprint, self.theirs, self.theirs)]:
            pairs = [(there, mine[here]) for there, here in zip(part.theirs, part.mine, strict=True) if here in mine]
            if pairs:
                theirs, here = zip(*pairs, strict=True)
                parts.append(Part(part.fingerprint, theirs, here))
        return parts


def reusable(stamps: Sequence[str], libraries: Sequence[Stored]) -> tuple[list[Reused], list[int]]:
    """What can be taken from some libraries, most from the one that has most; positions of what none of them has."""
    wanted = {stamp: i for i, stamp in reversed(list(enumerate(stamps)))}
    left, reused = set(range(len(stamps))), []
    places = [{wanted[s]: i for i, s in enumerate(stored.stamps) if s in wanted} for stored in libraries]
    held = list(zip(libraries, places, strict=True))
    while held and left:
        stored, place = max(held, key=lambda pair: len(left & pair[1].keys()))
        mine = sorted(left & place.keys())
        if not mine:
            break
        reused.append(Reused(stored, tuple(place[i] for i in mine), tuple(mine)))
        left -= set(mine)
    return reused, sorted(left)


class GramSum:
    """B^T B over the cells that every material measured, a block of cells at a time; what is known is not summed anew.

    The reused library with most columns brings its own Gram matrix, which is corrected where other cells are shared.
    """

    def __init__(self, n: int, everywhere: Tensor, reused: Sequence[Reused]) -> None:
        """For n columns and the cells (N_CELLS,) bool that every material measured."""
        self.everywhere, self._known = everywhere, torch.zeros(0, dtype=torch.int64)
        self.gram = torch.zeros(n, n, dtype=torch.float64)
        self._changes = torch.zeros_like(everywhere)
        base = max(reused, key=lambda part: len(part.mine), default=None)
        if base is not None:
            before = shared_cells(base.stored.valid)
            if (before ^ everywhere).sum() < everywhere.sum() / 2:
                self._known, theirs = columns_of(base.mine), columns_of(base.theirs)
                self._start = base.stored.gram[theirs][:, theirs]
                self.gram[self._known[:, None], self._known] = self._start
                self._changes = before ^ everywhere
        kept = torch.ones(n, dtype=torch.bool)
        kept[self._known] = False
        self._others = torch.nonzero(kept).ravel()

    def add(self, cells: slice, rows: Tensor) -> None:
        """Rows (N, n) of a block of cells, float32 or float64."""
        everywhere, changed = self.everywhere[cells], self._changes[cells]
        if len(self._known) and changed.any():
            sign = torch.where(everywhere[changed], 1.0, -1.0).double()
            some = rows[changed][:, self._known].double()
            self.gram[self._known[:, None], self._known] += (some * sign[:, None]).T @ some
        shared = rows[everywhere].double()
        if not len(self._known):
            self.gram += lower_gram(shared.T)
        elif len(self._others):
            product = shared[:, self._others].T @ shared
            self.gram[self._others] += product
            both = self._known
            self.gram[both[:, None], self._others] += product[:, both].T

    @property
    def exact(self) -> bool:
        """Whether what was subtracted left enough digits."""
        if not len(self._known):
            return True
        left = self.gram.diagonal()[self._known]
        return bool((left >= _LOST_DIGITS * self._start.diagonal()).all())

    def total(self) -> Tensor:
        """(n, n), symmetric."""
        if len(self._known):
            return (self.gram + self.gram.T) / 2
        return self.gram.tril() + self.gram.tril(-1).T
