"""Columns that a library need not compute, as other libraries have stored them."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.brdf.gram import lower_gram
from torchbrdf.brdf.stored_columns import Part, StoredColumns, columns_of, shared_cells

_LOST_DIGITS = 1e-5
"""Of a diagonal of the Gram matrix: where less is left after a subtraction, the sum is taken anew."""

_ROWS_AT_ONCE = 512
"""Of 1,500 columns 6 MB, which stay in the processor's cache while a few of them are multiplied with all."""


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

    def __init__(self, scale: Tensor, everywhere: Tensor, reused: Sequence[Reused], fresh: Tensor) -> None:
        """For columns stored as f_r / scale (n,), of which some (k,) are new, and the cells that all measured."""
        n = len(scale)
        self.scale, self.everywhere, self.fresh = scale, everywhere, fresh
        self._known = torch.zeros(0, dtype=torch.int64)
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

    def add(self, cells: slice, halves: Tensor, exact: Tensor) -> None:
        """f_r / scale in a block of cells: (N, n) float16, and (N, k) of the new columns before they were rounded."""
        everywhere, known = self.everywhere[cells], self._known
        if not len(known):
            self.gram += lower_gram(self._rows(halves, exact, everywhere).T)
            return
        changed = self._changes[cells]
        if changed.any():
            sign = torch.where(everywhere[changed], 1.0, -1.0).double()
            some = halves[changed][:, known].double()
            self.gram[known[:, None], known] += (some * sign[:, None]).T @ some
        if len(self._others):
            product = self.gram.new_zeros(len(self._others), len(self.gram))
            for some in torch.nonzero(everywhere).ravel().split(_ROWS_AT_ONCE):
                shared = self._rows(halves, exact, some)
                product += shared[:, self._others].T @ shared
            self.gram[self._others] += product
            self.gram[known[:, None], self._others] += product[:, known].T

    def _rows(self, halves: Tensor, exact: Tensor, some: Tensor) -> Tensor:
        """Some cells of all columns; in the new ones' own precision where there are no others."""
        if len(self.fresh) == halves.shape[1]:
            return exact[some]
        rows = halves[some].double()
        rows[:, self.fresh] = exact[some].double()
        return rows

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
