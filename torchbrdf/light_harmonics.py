"""A light probe about the view direction: Fourier series in azimuth, splines over the polar angle."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import atan2, pi, radians, sin

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from torchbrdf.harmonic_grid import Zone, zones
from torchbrdf.latlong import patch_of, texel_coordinates
from torchbrdf.probe import LightProbe

LINES = 576
"""Lines of equal polar angle on which radiance is read; twice as many places on each."""

FINEST_HEIGHT = 600
"""Rows of texels that these lines resolve; larger probes are averaged to so many."""

_BLUR = radians(0.1)
"""Standard deviation of a blur along the probe's own rows: it spreads the texels that crowd at its poles."""


LightHarmonics = list[tuple[Tensor, Tensor]]
"""Coefficients l of every zone, and i l, each (M, 6, elevations) float32: real parts of R, G and B, then imaginary."""


@dataclass(frozen=True, eq=False)
class TurningLight:
    """A probe whose harmonics are wanted in several orientations."""

    probe: LightProbe

    def harmonics(self, rotation: Tensor | None = None) -> LightHarmonics:
        """The coefficients of the probe turned by a rotation (3, 3), as in `LightProbe.rotated`; None for none.

        A turn about the view axis +Z is a phase. Gradients flow to the radiance and to the rotation.
        """
        if rotation is None:
            return [_with_multiple(spectrum) for spectrum in self._upright]
        angle = None if rotation.requires_grad else _turn_about_view(rotation)
        if angle is None:
            return [_with_multiple(spectrum) for spectrum in self._spectra(rotation)]
        found = []
        for spectrum in self._upright:
            phase = -angle * torch.arange(spectrum.shape[1], device=spectrum.device)
            found.append(_with_multiple(spectrum * torch.polar(torch.ones_like(phase), phase)[:, None]))
        return found

    @cached_property
    def _upright(self) -> list[Tensor]:
        return self._spectra(None)

    @cached_property
    def _texels(self) -> Tensor:
        """(3, H, 2 H) radiance."""
        probe = self.probe if self.probe.height <= FINEST_HEIGHT else self.probe.resized(FINEST_HEIGHT)
        radiance, blur = probe.radiance, _blur(probe.height, str(probe.device))
        n = len(blur)
        top, middle, bottom = radiance.split([n, probe.height - 2 * n, n], dim=1)
        top, bottom = (
            torch.fft.irfft(torch.fft.rfft(rows) * response, n=probe.width)
            for rows, response in ((top, blur), (bottom, blur.flip(0)))
        )
        return torch.cat([top, middle, bottom], 1)

    def _spectra(self, rotation: Tensor | None) -> list[Tensor]:
        """(elevations, M, 3) complex64 for every zone."""
        height, device = self._texels.shape[1], str(self._texels.device)
        if rotation is None:
            texels, weights = _lookup(height, device)
        else:
            turned = _polar_directions() @ rotation.to("cpu", torch.float32)  # a row vector times R is R^T d
            texels, weights = _lookup_at(turned, height, device)
        radiance = self._texels.flatten(1).T.contiguous()
        seen = embedding_bag(texels, radiance, mode="sum", per_sample_weights=weights)
        spectrum = torch.fft.rfft(seen.view(LINES, 2 * LINES, 3), dim=1, norm="forward")
        flat = torch.view_as_real(spectrum).flatten(1)
        parts = [(_projection(zone, device) @ flat[:, : 6 * zone.frequencies]) for zone in zones()]
        return [torch.view_as_complex(part.view(len(part), -1, 3, 2)) for part in parts]


def _with_multiple(spectrum: Tensor) -> tuple[Tensor, Tensor]:
    real, imaginary = torch.view_as_real(spectrum).permute(3, 1, 2, 0)
    return torch.cat([real, imaginary], 1), torch.cat([-imaginary, real], 1)


def _turn_about_view(rotation: Tensor) -> float | None:
    """The angle of a turn about +Z, from +X towards +Y; None for any other."""
    r = rotation.tolist()
    if max(abs(r[0][2]), abs(r[1][2]), abs(r[2][0]), abs(r[2][1])) > 1e-7 or r[2][2] < 0:
        return None
    return atan2(r[1][0], r[0][0])


@lru_cache(maxsize=1)
def _polar_directions() -> Tensor:
    """(LINES * 2 LINES, 3) float32: directions with polar angle beta to +Z and azimuth from +X towards +Y."""
    beta = ((torch.arange(LINES, dtype=torch.float64) + 0.5) * (pi / LINES))[:, None]
    phi = torch.arange(2 * LINES, dtype=torch.float64) * (pi / LINES)
    sine = torch.sin(beta)
    axes = [sine * torch.cos(phi), sine * torch.sin(phi), torch.cos(beta).expand(-1, 2 * LINES)]
    return torch.stack(axes, dim=-1).float().flatten(0, 1)


def _lookup_at(directions: Tensor, height: int, device: str) -> tuple[Tensor, Tensor]:
    """Four texels (N, 4) int32 between which directions (N, 3) lie, and their bilinear weights."""
    width = 2 * height
    x, y, _ = texel_coordinates(directions, height, width)
    column, row, s, t = patch_of(x, y, height, width)
    first = row * width + column
    following = torch.where(column == width - 1, first - (width - 1), first + 1)
    texels = torch.stack([first, following, first + width, following + width], -1)
    weights = torch.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t], -1)
    return texels.int().to(device), weights.to(device)


@lru_cache(maxsize=4)
def _lookup(height: int, device: str) -> tuple[Tensor, Tensor]:
    return _lookup_at(_polar_directions(), height, device)


@lru_cache(maxsize=8)
def _blur(height: int, device: str) -> Tensor:
    """(N, H + 1): the transform of the blur along the N rows next to a pole where texels are narrower than it.

    The row at the pole itself counts as at a third of a row's distance: bilinear radiance shows it up to the next row.
    """
    step = pi / (height - 1)
    sine = torch.sin(torch.arange(height // 2, dtype=torch.float64) * step)
    narrow = max(1, int((sine < 2 * _BLUR * height / pi).sum()))
    spread = _BLUR / sine[:narrow, None].clamp_min(sin(step / 3))
    frequency = torch.arange(height + 1, dtype=torch.float64)
    return torch.exp(-0.5 * (frequency * spread).square()).float().to(device)


@lru_cache(maxsize=16)
def _projection(zone: Zone, device: str) -> Tensor:
    return zone.light_projection(LINES).to(device)
