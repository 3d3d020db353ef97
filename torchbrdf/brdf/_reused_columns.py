"""Columns that a library need not compute, as other libraries have stored them."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.brdf.gram import lower_gram
from torchbrdf.brdf.stored_columns import Part, StoredColumns, columns_of, shared_cells

_LOST_DIGITS = 1e-5
"""Of a diagonal of the Gram matrix: where less is left after a subtraction, the sum is taken anew."""


@dataclass(frozen=True)
class Reused:
    """Materials of a library to build, and where they are stored."""

    stored: StoredColumns
    theirs: tuple[int, ...]
    mine: tuple[int, ...]

    @property
    def parts(self) -> list[Part]:
        """By the libraries that the stored one itself was made from, if it was."""
        parts = []
        for part in self.stored.parts or [Part(self.stored.fingerprint, self.theirs, self.theirs)]:
            places = dict(zip(part.mine, part.theirs, strict=True))
            pairs = [(places[i], mine) for i, mine in zip(self.theirs, self.mine, strict=True) if i in places]
            if pairs:
                theirs, here = zip(*pairs, strict=True)
                parts.append(Part(part.fingerprint, theirs, here))
        return parts


def reusable(stamps: Sequence[str], libraries: Sequence[StoredColumns]) -> tuple[list[Reused], list[int]]:
    """What can be taken from some libraries, most from the one that has most; positions of what none of them has."""
    left, reused, held = set(range(len(stamps))), [], []
    for stored in libraries:
        where = {stamp: i for i, stamp in reversed(list(enumerate(stored.stamps)))}
        held.append((stored, {mine: where[stamp] for mine, stamp in enumerate(stamps) if stamp in where}))
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

    def __init__(self, scale: Tensor, everywhere: Tensor, reused: Sequence[Reused]) -> None:
        """For columns stored as f_r / scale (n,), and the cells (N_CELLS,) bool that every material measured."""
        n = len(scale)
        self.scale, self.everywhere, self._known = scale, everywhere, torch.zeros(0, dtype=torch.int64)
        self.gram = torch.zeros(n, n, dtype=torch.float64)  # of f_r / scale
        self._changes = torch.zeros_like(everywhere)
        base = max(reused, key=lambda part: len(part.mine), default=None)
        if base is not None:
            before = shared_cells(base.stored.valid)
            if (before ^ everywhere).sum() < everywhere.sum() / 2:
                self._known, theirs = columns_of(base.mine), columns_of(base.theirs)
                factors = scale[self._known]
                self._start = base.stored.gram[theirs][:, theirs] / (factors[:, None] * factors)
                self.gram[self._known[:, None], self._known] = self._start
                self._changes = before ^ everywhere
        kept = torch.ones(n, dtype=torch.bool)
        kept[self._known] = False
        self._others = torch.nonzero(kept).ravel()

    def add(self, cells: slice, rows: Tensor) -> None:
        """Rows (N, n) of f_r / scale in a block of cells."""
        everywhere, changed = self.everywhere[cells], self._changes[cells]
        if len(self._known) and changed.any():
            sign = torch.where(everywhere[changed], 1.0, -1.0).double()
            some = rows[changed][:, self._known].double()
            self.gram[self._known[:, None], self._known] += (some * sign[:, None]).T @ some
        if not len(self._known):
            self.gram += lower_gram(rows[everywhere].double().T)
        elif len(self._others):
            shared = rows[everywhere].double()
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
        found = (self.gram + self.gram.T) / 2 if len(self._known) else self.gram.tril() + self.gram.tril(-1).T
        return found * (self.scale[:, None] * self.scale)
