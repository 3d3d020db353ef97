"""The measured table of one material: MERL's file format, grid, validity and lookup [MPBM03].

A table holds f_r in 1/sr (cosine not included) on 90 x 90 x 180 cells of theta_h, theta_d, phi_d, with theta_h
warped by a square root. phi_d covers [0, pi): reciprocity is phi_d -> phi_d + pi.
"""

import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from torchbrdf.brdf.directions import from_half_difference, half_difference
from torchbrdf.brdf.merl_grid import (
    GRID,
    N_CELLS,
    above_horizon,
    cell_centres,
    cell_index,
    grid_coordinates,
    measured_share,
)
from torchbrdf.brdf.settings import AGAIN, RGL_SUFFIX
from torchbrdf.files import existing_file, writing
from torchbrdf.lasting import LastMade, lasting, on_disk

CHANNEL_SCALE = (1.0 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0)
"""A MERL file stores f_r / CHANNEL_SCALE for R, G and B."""

LARGEST = 1e11
"""Of f_r, in 1/sr: no BRDF on this grid holds more.

A mirror that spreads light over the half vectors of the smallest cell, theta_h < pi/2 / 90^2, reflects no more than it
gets where f_r cos^2 theta_d <= 2.1e6; in the last row of theta_d that is f_r <= 2.8e10. Measured highlights reach 1e4.
"""

_HEADER_BYTES = 12
FILE_BYTES = _HEADER_BYTES + 3 * N_CELLS * 8
_FULL_GRID = (*GRID[:2], 2 * GRID[2])
Interpolation = Literal["nearest", "linear"]


@lru_cache(maxsize=1)
@lasting
def _nearest_above_horizon() -> Tensor:
    """For whole tables: most are, so it is kept on disk."""
    whole = above_horizon().numpy().tobytes()
    return on_disk("grids", [GRID], lambda: {"cells": _nearest_measured(whole).int()})["cells"].long()


@lru_cache(maxsize=4)
@lasting
def _nearest_measured(valid: bytes) -> Tensor:
    """For every cell the flat index of the nearest measured one, in units of cells, phi_d periodic."""
    from scipy.ndimage import distance_transform_edt

    mask = np.frombuffer(valid, dtype=bool).reshape(GRID)
    half = GRID[2] // 2
    wrapped = np.concatenate([mask[..., -half:], mask, mask[..., :half]], axis=-1)
    h, d, p = distance_transform_edt(~wrapped, return_distances=False, return_indices=True)[..., half:-half]
    return torch.from_numpy(((h * GRID[1] + d) * GRID[2] + (p - half) % GRID[2]).ravel())


def nearest_measured(valid: Tensor) -> Tensor:
    """(N_CELLS,) int64: what to read in place of each cell so that unmeasured ones take their nearest neighbour.

    valid  (90, 90, 180), or as many in another shape
    """
    valid = valid.cpu().contiguous().view(GRID)
    if torch.equal(valid, above_horizon()):
        return _nearest_above_horizon()
    return _nearest_measured(valid.numpy().tobytes())


@dataclass(frozen=True, eq=False)
class MerlTable:
    """One RGB BRDF on the MERL grid.

    values  (90, 90, 180, 3)  f_r in 1/sr; meaningless where not valid. Not copied: a NumPy array whose memory they
                              share is not to be written to, which `lookup` does not notice, as it does of tensors
    valid   (90, 90, 180)     bool, True where measured
    name    str               the material
    """

    values: Tensor
    valid: Tensor
    name: str = "unnamed"
    _filled: LastMade[Tensor] = field(default_factory=LastMade, init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the shapes; mark cells below the horizon as not measured."""
        if self.values.shape != (*GRID, 3) or self.valid.shape != GRID:
            raise ValueError(
                f"a MERL table needs values {(*GRID, 3)} and valid {GRID}, "
                f"got {tuple(self.values.shape)} and {tuple(self.valid.shape)}"
            )
        object.__setattr__(self, "valid", self.valid.bool() & above_horizon().to(self.valid.device))
        if not self.valid.any():
            raise ValueError(f"{self.name}: the table has no measured cell: all are negative or below the horizon")
        values = self.values.detach()
        if float(values.amin()) >= -LARGEST and float(values.amax()) <= LARGEST:
            return  # not so where there is a NaN
        measured = values[self.valid]
        unsound = int((~torch.isfinite(measured)).any(-1).sum())
        if unsound:
            raise ValueError(f"{self.name}: {unsound} cells of the table are NaN or infinite")
        excessive = int((measured.abs() > LARGEST).any(-1).sum())
        if excessive:
            raise ValueError(
                f"{self.name}: {excessive} cells of the table exceed {LARGEST:.0e} 1/sr, "
                f"up to {float(measured.abs().max()):.2g}, "
                "which no BRDF can"
            )

    def __repr__(self) -> str:
        """Name, `measured_share` and range."""
        measured = self.values[self.valid]
        return (
            f"MerlTable({self.name!r}, measured {self.measured_share:.1%}, "
            f"f_r {measured.min():.3g} to {measured.max():.3g} 1/sr)"
        )

    @property
    def measured_share(self) -> float:
        """Share of the cells above the horizon that were measured."""
        return measured_share(self.valid)

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> "MerlTable":
        """Read a MERL `.binary` file.

        Cells with a negative channel were not measured. Raises as `existing_file`; ValueError where the header is not
        90, 90, 180, the length does not fit, or a cell is NaN, infinite, or beyond LARGEST.
        """
        path = Path(path)
        check_file(path)
        stored = read_planes(path)
        valid = (stored >= 0).all(0) | ~np.isfinite(stored).all(0)
        values = torch.from_numpy(stored.T.reshape(*GRID, 3) * np.array(CHANNEL_SCALE))
        try:
            return cls(values, torch.from_numpy(valid.reshape(GRID)), path.stem)
        except ValueError as error:
            problem = str(error).removeprefix(f"{path.stem}: ")
            raise ValueError(f"{path}: {problem}; {AGAIN}") from None

    @classmethod
    def from_bsdf(cls, path: str | os.PathLike[str], isotropic: bool = False) -> "MerlTable":
        """Tabulate a measured material of the RGL database, a `.bsdf` file, RGB or spectral [DJ18].

        isotropic  take the mean over all azimuths of a material that is not
        Cells that the database did not measure are not valid, nor are those of negative luminance. Other colours
        outside Rec. 709 have their negative channels set to 0; warns where that, or the mean over azimuths, changes the
        material by more than 1 %. Raises as `RGLMaterial.open`, and ValueError for an anisotropic material.
        """
        from torchbrdf.brdf.rgl import RGLMaterial
        from torchbrdf.brdf.rgl_table import tabulate

        material = RGLMaterial.open(path)
        if not (isotropic or material.isotropic):
            raise ValueError(
                f"{path}: anisotropic, measured for {len(material.phi_i)} azimuths, and a MERL table has none: "
                "isotropic=True, or `torchbrdf convert --isotropic`, takes its mean over them"
            )
        found = tabulate(material)
        if found.clipped > 0.01:
            share = f"{found.negative:.0%}" if found.negative > 0.005 else "less than 1%"
            warnings.warn(
                f"{path}: {share} of its cells have colours outside Rec. 709, whose negative channels are "
                f"set to 0, which changes it by {found.clipped:.1%}",
                UserWarning,
                stacklevel=2,
            )
        if found.spread > 0.01:
            message = f"{path}: anisotropic; its mean over all azimuths differs from it by {found.spread:.1%}"
            warnings.warn(message, UserWarning, stacklevel=2)
        if not found.valid.any():
            raise ValueError(f"{path}: none of MERL's cells rests on what was measured; this is no whole measurement")
        return cls(found.values, found.valid, material.name)

    @classmethod
    def of_filled(cls, values: Tensor, valid: Tensor, name: str = "unnamed") -> "MerlTable":
        """A table (90, 90, 180, 3) in which cells that were not measured hold their nearest measured one already.

        valid  (90, 90, 180) bool, True where measured
        """
        table = cls(values, valid, name)
        table._filled.get_or_make([values], lambda: values.detach().reshape(N_CELLS, 3))
        return table

    @classmethod
    def from_function(cls, f_r: Callable[[Tensor, Tensor], Tensor], name: str = "unnamed") -> "MerlTable":
        """Tabulate f_r(w_i, w_o) at the centres of the cells above the horizon.

        f_r  unit directions (N, 3) to light and camera -> (N, 3) in 1/sr, or what spreads to that: (N, 1) of a grey
             material, (3,) of one that is the same everywhere
        Raises ValueError where it gives something else.
        """
        valid = above_horizon()
        w_i, w_o = (directions.clone() for directions in _directions())  # f_r may write into them
        given = f_r(w_i, w_o)
        shape = tuple(given.shape) if isinstance(given, Tensor) else type(given).__name__
        if shape not in ((len(w_i), 3), (len(w_i), 1), (1, 3), (3,), (1,), ()):
            raise ValueError(
                f"{name}: f_r must give a tensor {(len(w_i), 3)}, R, G and B for each pair of directions, got {shape}; "
                "[..., None] makes one of a grey material's values"
            )
        values = torch.zeros(*GRID, 3, dtype=torch.float64)
        values[valid] = given.to(torch.float64)
        return cls(values, valid, name)

    def save(self, path: str | os.PathLike[str], spectral: bool = False) -> None:
        """Write a MERL `.binary`, or an RGL `.bsdf` where the path ends so, which renderers open without a plugin.

        In a `.binary` cells that were not measured become -1, negative measured ones 0.
        A `.bsdf` is RGB, for RGB variants of Mitsuba 3; spectral=True: spectra of the same colours under D65, for its
        spectral variants and pbrt-v4. Cells that were not measured take their nearest measured one.
        """
        if Path(path).suffix.lower() == RGL_SUFFIX:
            from torchbrdf.brdf.rgl_writing import write_bsdf

            with writing(path) as temporary:
                write_bsdf(temporary, lambda *at: _trilinear([self], *at)[0], self.valid.cpu(), self.name, spectral)
            return
        if spectral:
            raise ValueError(f"{path}: spectral is for a {RGL_SUFFIX} file; a MERL table has red, green and blue alone")
        values, unmeasured = self.values.detach().cpu(), ~self.valid.cpu()
        with writing(path) as temporary, open(temporary, "wb") as file:
            np.array(GRID, "<i4").tofile(file)
            for channel, scale in enumerate(CHANNEL_SCALE):
                plane = values[..., channel].double() / scale
                plane.clamp_min_(0).masked_fill_(unmeasured, -1.0)
                plane.contiguous().numpy().astype("<f8", copy=False).tofile(file)

    @property
    def filled(self) -> Tensor:
        """(N_CELLS, 3) values with each unmeasured cell replaced by its nearest measured one; made once, or anew for
        gradients."""
        if self.values.requires_grad and torch.is_grad_enabled():
            return self._fill()
        return self._filled.get_or_make([self.values], lasting(self._fill))

    def _fill(self) -> Tensor:
        return self.values.reshape(N_CELLS, 3)[nearest_measured(self.valid).to(self.values.device)]

    def lookup(self, w_i: Tensor, w_o: Tensor, interpolation: Interpolation = "nearest") -> Tensor:
        """f_r of direction pairs; 0 where a direction lies below the horizon, NaN where one is NaN.

        w_i, w_o       (..., 3)  unit vectors in the local frame (normal +Z)
        interpolation  "nearest" cell, as MERL's own code, or "linear" in the three warped coordinates
        returns        (..., 3)  1/sr, in the precision of w_i
        Raises ValueError for directions that are not (..., 3), or another interpolation.
        """
        if interpolation == "linear":
            return linear_lookups([self], w_i, w_o)[0]
        if interpolation != "nearest":
            raise ValueError(f'interpolation must be "nearest" or "linear", got {interpolation!r}')
        angles = half_difference(w_i, w_o)
        return _where_visible(self.filled[cell_index(*angles).long()], w_i, w_o, angles[1])


def linear_lookups(tables: Sequence[MerlTable], w_i: Tensor, w_o: Tensor) -> list[Tensor]:
    """`MerlTable.lookup` of several tables, "linear", by the same cells: where they lie takes most of the time."""
    angles = half_difference(w_i, w_o)
    found = _trilinear(tables, *grid_coordinates(*angles))
    return [_where_visible(f_r, w_i, w_o, angles[1]) for f_r in found]


def _where_visible(f_r: Tensor, w_i: Tensor, w_o: Tensor, theta_d: Tensor) -> Tensor:
    """f_r, 0 below the horizon; theta_d is NaN where any part of a direction is, and so is what is returned."""
    visible = (w_i[..., 2] > 0) & (w_o[..., 2] > 0) & (theta_d >= 0)
    return torch.where(visible[..., None], f_r, (0 * theta_d.detach()).to(f_r)[..., None]).to(w_i.dtype)


def _trilinear(tables: Sequence[MerlTable], h: Tensor, d: Tensor, p: Tensor) -> list[Tensor]:
    lower = [torch.floor(c - 0.5) for c in (h, d, p)]
    fraction = [c - 0.5 - low for c, low in zip((h, d, p), lower, strict=True)]
    totals: list[Tensor | float] = [0.0] * len(tables)
    for corner in range(8):
        steps = [(corner >> axis) & 1 for axis in range(3)]
        i_h = (lower[0].long() + steps[0]).clamp_(0, GRID[0] - 1)
        i_d = (lower[1].long() + steps[1]).clamp_(0, GRID[1] - 1)
        i_p = torch.remainder(lower[2].long() + steps[2], GRID[2])
        weight = torch.ones_like(h)
        for f, step in zip(fraction, steps, strict=True):
            weight = weight * (f if step else 1 - f)
        cells = (i_h * GRID[1] + i_d) * GRID[2] + i_p
        totals = [total + weight[..., None] * table.filled[cells] for total, table in zip(totals, tables, strict=True)]
    return [torch.as_tensor(total) for total in totals]


@lru_cache(maxsize=1)
@lasting
def _directions() -> tuple[Tensor, Tensor]:
    """(N, 3) float64 to light and camera of the cells above the horizon, which every table of a function needs."""
    valid = above_horizon()
    w_i, w_o = from_half_difference(*cell_centres())
    return w_i[valid], w_o[valid]


def check_file(path: Path) -> None:
    """Raise where a path is not a whole MERL file; reads its header only, so a lying header allocates nothing."""
    existing_file(path, "a MERL .binary table")
    size = path.stat().st_size
    with open(path, "rb") as file:
        header = file.read(_HEADER_BYTES)
    dimensions = tuple(np.frombuffer(header, "<i4").tolist()) if len(header) == _HEADER_BYTES else None
    if dimensions == _FULL_GRID:
        raise ValueError(
            f"{path}: a MERL table of all of phi_d, {_FULL_GRID}, as BRDFs that are not reciprocal need; only {GRID}, "
            "0 to 180 degrees, is read: write that half of it"
        )
    if dimensions != GRID:
        raise ValueError(f"{path}: not a MERL table: the header must be {GRID}, got {dimensions or header!r}")
    if size != FILE_BYTES:
        state = "truncated" if size < FILE_BYTES else "oversized"
        raise ValueError(f"{path}: {state} MERL table: expected {FILE_BYTES} bytes, got {size}; {AGAIN}")


def read_planes(path: Path, first: int = 0, count: int = N_CELLS) -> np.ndarray:
    """(3, count) float64 as stored: the cells from `first` on of the R, G and B planes of a checked file."""
    planes = np.empty((3, count), "<f8")
    with open(path, "rb", buffering=0) as file:
        for channel, plane in enumerate(planes):
            file.seek(_HEADER_BYTES + 8 * (channel * N_CELLS + first))
            if file.readinto(plane.data) != plane.nbytes:
                raise ValueError(f"{path}: became shorter while it was read; {AGAIN}")
    return planes
