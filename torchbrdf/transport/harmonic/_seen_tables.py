"""What the harmonic transport wants to know of a single table, and keeps while the table lives."""

import weakref
from collections.abc import Hashable
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.brdf import GRID, MerlTable
from torchbrdf.lasting import LastMade, lasting
from torchbrdf.transport.harmonic._table_kernels import Detail, Reflections
from torchbrdf.transport.harmonic.grid import Zone

_SYMMETRIC = 2e-3
"""Relative difference of f_r at phi_d and -phi_d below which one stands for both."""

_DULL = ((3, 27, 0.75), (1, 13, 1.2))
"""Zones that are left to the next where f_r changes by less, in so many rows of theta_h, in terms of its mean."""

_LIT = 80
"""Rows of theta_d, in degrees, that tell."""

_AT_ONCE = 5
"""Rows of theta_h that are looked at together: what a processor's cache holds."""


@dataclass(eq=False)
class SeenTable:
    """A table as the kernels need it.

    values     (cells, 3) float32: f_r
    symmetric  whether it is the same for phi_d and -phi_d
    merged     zones that it does not need, see `Detail`
    """

    values: Tensor
    symmetric: bool
    merged: int
    _wanted: Hashable = None
    _kept: dict[Reflections, list[Tensor]] | None = None

    @staticmethod
    def of(table: MerlTable) -> "SeenTable":
        """Made once a table, as long as nothing is written into it."""
        return _SEEN.setdefault(table, LastMade()).get_or_make([table.values], lambda: _seen(table))

    def show(self, detail: Detail, distance: float | None) -> None:
        """Tell what `kernels` are wanted for: those of a table that was shown alike just before are kept this time."""
        for other in list(_SHOWN_LAST):
            if other is not self:
                other._wanted = other._kept = None
        _SHOWN_LAST.clear()
        _SHOWN_LAST.add(self)
        if self._wanted != (detail, distance):
            self._wanted, self._kept = (detail, distance), None
        elif self._kept is None:
            self._kept = {}

    @property
    def kept(self) -> bool:
        """Whether there are kernels that wait for another picture."""
        return bool(self._kept)

    def kernels(self, zone: Zone, some: Reflections, frequencies: int) -> list[Tensor]:
        """See `Reflections.kernels`."""
        kept = self._kept  # another thread may show another table
        if kept is None:
            return some.kernels(zone, self.values, self.symmetric, frequencies)
        if some not in kept:
            kept[some] = lasting(some.kernels)(zone, self.values, self.symmetric, some.turning)
        return [part[:frequencies] for part in kept[some]]


_SEEN: "weakref.WeakKeyDictionary[MerlTable, LastMade[SeenTable]]" = weakref.WeakKeyDictionary()

_SHOWN_LAST: "weakref.WeakSet[SeenTable]" = weakref.WeakSet()
"""One at most: kernels take a hundred MB, so a program that shows many tables once keeps none."""


@lasting
def _seen(table: MerlTable) -> SeenTable:
    values = table.filled.float().cpu()
    return SeenTable(values, _is_symmetric(table), _merged(values.view(*GRID, 3)))


def _is_symmetric(table: MerlTable) -> bool:
    """Whether f_r is the same at phi_d and -phi_d wherever it was measured."""
    half = GRID[2] // 2
    for valid, values in zip(table.valid.cpu().split(_AT_ONCE), table.values.cpu().split(_AT_ONCE), strict=True):
        here, there = values[:, :, :half], values[:, :, half:].flip(2)
        same = ((here - there).abs() <= _SYMMETRIC * here.abs()).all(-1)
        measured = valid[:, :, :half]
        if not (torch.equal(measured, valid[:, :, half:].flip(2)) and bool((same | ~measured).all())):
            return False
    return True


def _merged(values: Tensor) -> int:
    """Of f_r (90, 90, 180, 3): how many zones, from the mirror direction, have no lobe that the next could not hold."""
    for merged, rows, most in _DULL:
        profile = values[:rows, :_LIT].mean(2)
        change = (profile.amax(0) - profile.amin(0)) / profile.mean(0).clamp_min(torch.finfo(profile.dtype).tiny)
        if float(change.quantile(0.9)) <= most:
            return merged
    return 0
