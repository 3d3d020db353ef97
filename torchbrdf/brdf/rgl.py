"""Measured materials as the RGL database has them: `.bsdf` files in the adaptive parameterisation of [DJ18].

For a direction of incidence w_i the unit square of half vectors m, by theta_m with MERL's square root and by the
azimuth from w_i, is warped by what a microfacet model expects there, and f_r cos(theta_o) is kept in the warped square:

    f_r cos(theta_o) = c(s) D(m) / (4 sigma(w_i)),  s = the place of m in the warped square

with the normal distribution D and the projected area sigma of the microfacets, all of them interpolated linearly. That
is what Mitsuba's `measured` evaluates, w_i towards the camera.
"""

import os
from dataclasses import dataclass
from math import pi
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchbrdf.brdf._tensor_file import TensorFile
from torchbrdf.brdf._warps import Between, Grids, Warps
from torchbrdf.brdf.settings import AGAIN
from torchbrdf.brdf.spectra import to_rec709

WHAT = "an RGL .bsdf file of a measured material"
_BLUE, _RED = 460.0, 620.0
"""In nm: spectra that do not reach so far say nothing of blue or of red, or are in another unit."""

_MOST = 1e6
"""Of what a file holds in 1/sr or as density: none comes near."""


@dataclass(frozen=True)
class _Slices:
    """What is known where w_i has one azimuth: the warps, colours and measured places of each theta_i."""

    warps: Warps
    colours: Grids
    measured: Grids


@dataclass(frozen=True)
class RGLMaterial:
    """What a file holds.

    name     the file's, without its suffix
    theta_i  (t,) radians, increasing
    phi_i    (p,) radians; one value: the material is isotropic
    """

    name: str
    theta_i: Tensor
    phi_i: Tensor
    _slices: tuple[_Slices, ...]
    _normals: Grids | None
    _areas: Grids

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> "RGLMaterial":
        """Read and check a file, RGB or spectral; the latter's colours become linear Rec. 709, see `to_rec709`.

        Raises as `existing_file`; ValueError for anything that is not such a file, is cut off or does not fit together.
        """
        path = Path(path)
        file = TensorFile(path, WHAT)
        theta_i, phi_i = (_increasing(file, name, "angles") for name in ("theta_i", "phi_i"))
        if theta_i[0] < 0 or theta_i[-1] > pi / 2 + 1e-3:
            ends = f"{theta_i[0]:.4g} to {theta_i[-1]:.4g}"
            raise ValueError(f"{path}: theta_i goes from {ends}, beyond 0 to pi/2; {AGAIN}")
        if max(abs(phi_i[0]), abs(phi_i[-1])) > 2 * pi + 1e-3:
            ends = f"{phi_i[0]:.4g} to {phi_i[-1]:.4g}"
            raise ValueError(f"{path}: phi_i goes from {ends}, beyond a whole turn in radians; {AGAIN}")
        parameters = (len(phi_i), len(theta_i))
        density = _sound(file, "vndf", parameters, least=0.0)
        if not (density.sum((2, 3)) > 0).all():
            raise ValueError(f"{path}: the field 'vndf' is 0 for some direction of incidence; {AGAIN}")
        colours = _colours(file, parameters)
        measured = _measured(file, colours.shape)
        slices = [_Slices(Warps.of(density[p]), Grids.of(colours[p]), Grids.of(measured[p])) for p in range(len(phi_i))]
        normals, areas = _sound(file, "ndf", (), least=0.0), _sound(file, "sigma", (), least=0.0)
        if not (areas > 0).all():
            raise ValueError(f"{path}: the field 'sigma' is 0 somewhere, and f_r would be infinite; {AGAIN}")
        has_normals = bool(file.read("jacobian", "u1", 1)[0])
        return cls(
            path.stem,
            torch.from_numpy(theta_i),
            torch.from_numpy(phi_i),
            tuple(slices),
            Grids.of(normals[None, None]) if has_normals else None,
            Grids.of(areas[None, None]),
        )

    @property
    def last_measured(self) -> float:
        """The largest theta_i that was measured: files repeat it at 90 degrees, where nothing can be."""
        colours = self._slices[0].colours.corners
        last, before = colours.view(len(self.theta_i), -1)[-2:] if len(self.theta_i) > 1 else (colours, None)
        return float(self.theta_i[-2 if before is not None and torch.equal(last, before) else -1])

    @property
    def isotropic(self) -> bool:
        """Whether f_r depends on the azimuth between directions alone."""
        return len(self.phi_i) == 1

    @property
    def azimuth_weights(self) -> list[float]:
        """Of each azimuth in the mean over all that w_i may have: those between the first and the last."""
        steps = torch.diff(self.phi_i)
        ends = torch.nn.functional.pad(steps, (1, 1))
        return ((ends[:-1] + ends[1:]) / (2 * steps.sum())).tolist()

    @property
    def mirrored(self) -> bool:
        """Whether azimuths of w_i are kept for a quarter turn alone, to which the others are mirrored."""
        return round(2 * pi / float(self.phi_i[-1] - self.phi_i[0])) == 4

    def cos_weighted(self, theta_i: Tensor, theta_m: Tensor, azimuth: Tensor, phi: int = 0) -> tuple[Tensor, Tensor]:
        """f_r cos(theta_o), and how far it was measured.

        theta_i, theta_m  (n,)  of w_i and of the half vector
        azimuth           (n,)  of the half vector, from w_i
        phi               index of the azimuth of w_i in `phi_i`
        returns           (n, 3) 1/sr, and (n,): 1 where all values around were measured, 0 where none
        """
        slices = self._slices[phi]
        between, alone = Between.of(theta_i, self.theta_i), Between.of(theta_i, self.theta_i[:1])
        turned = azimuth if self.isotropic else azimuth + self.phi_i[phi]
        x, y = torch.sqrt(theta_m * (2 / pi)), torch.remainder(turned * (0.5 / pi) + 0.5, 1.0)
        place = slices.warps.flattened(x, y, between)
        found = slices.colours.at(*place, between)
        if self._normals is not None:
            y_i = torch.full_like(x, 0.5 + float(self.phi_i[phi]) / (2 * pi))
            area = self._areas.at(torch.sqrt(theta_i * (2 / pi)), y_i, alone)
            found = found * (self._normals.at(x, y, alone) / (4 * area))
        return found, slices.measured.at(*place, between)[:, 0]


def _increasing(file: TensorFile, name: str, what: str) -> np.ndarray:
    values = file.read(name, "<f4", 1)
    if not (np.isfinite(values).all() and (np.diff(values) > 0).all()):
        raise ValueError(f"{file.path}: the field {name!r} must hold increasing {what}, got {values[:4]}...; {AGAIN}")
    return values


def _sound(file: TensorFile, name: str, leading: tuple[int, ...], axes: int = 2, least: float = -_MOST) -> np.ndarray:
    """A field of a grid at least 2 x 2 for each of the leading indices, its values from `least` to `_MOST`."""
    values = file.read(name, "<f4", len(leading) + axes)
    if values.shape[: len(leading)] != leading or min(values.shape[-2:]) < 2:
        expected = " x ".join(map(str, leading + ("n",) * axes))
        problem = f"must be {expected}, at least 2 x 2, got {values.shape}"
        raise ValueError(f"{file.path}: the field {name!r} {problem}; {AGAIN}")
    if not (values.min() >= least and values.max() <= _MOST):
        problem = "is not finite or beyond all measurements" if least < 0 else "is negative, not finite or too large"
        raise ValueError(f"{file.path}: the field {name!r} {problem} in places; {AGAIN}")
    return values


def _colours(file: TensorFile, parameters: tuple[int, int]) -> np.ndarray:
    """(p, t, 3, n, n) linear Rec. 709."""
    if "spectra" not in file and "rgb" in file:
        colours = _sound(file, "rgb", parameters, axes=3)
        if colours.shape[2] != 3:
            raise ValueError(f"{file.path}: the field 'rgb' must have 3 channels, got {colours.shape[2]}; {AGAIN}")
        return colours
    spectra = _sound(file, "spectra", parameters, axes=3)
    if "wavelengths" not in file:
        raise ValueError(f"{file.path}: spectra without the field 'wavelengths', so nobody knows of what; {AGAIN}")
    wavelengths = _increasing(file, "wavelengths", "wavelengths")
    if len(wavelengths) != spectra.shape[2]:
        raise ValueError(f"{file.path}: {spectra.shape[2]} spectral values for {len(wavelengths)} wavelengths; {AGAIN}")
    if wavelengths[0] > _BLUE or wavelengths[-1] < _RED:
        ends = f"{wavelengths[0]:.4g} to {wavelengths[-1]:.4g}"
        raise ValueError(f"{file.path}: wavelengths from {ends} do not reach from {_BLUE:g} to {_RED:g} nm; {AGAIN}")
    return np.einsum("cw,ptwyx->ptcyx", to_rec709(wavelengths), spectra, optimize=True).astype(np.float32)


def _measured(file: TensorFile, shape: tuple[int, ...]) -> np.ndarray:
    """(p, t, 1, n, n) float32: 1 where the database measured, 0 where it continued what it had."""
    everywhere = np.ones((*shape[:2], 1, *shape[3:]), np.float32)
    if "valid" not in file:
        return everywhere
    bits = np.unpackbits(file.read("valid", "u1", 1))
    if len(bits) < everywhere.size:
        raise ValueError(f"{file.path}: the field 'valid' has {len(bits)} bits for {everywhere.size} values; {AGAIN}")
    found = bits[: everywhere.size].reshape(everywhere.shape).astype(np.float32)
    # Some files mark what was measured, others what was not. No one measured a reflection below the horizon, as at the
    # last half vector of normal incidence.
    return found if found[0, 0, 0, 0, -1] == 0 else 1 - found
