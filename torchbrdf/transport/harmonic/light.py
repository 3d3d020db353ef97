"""A light probe about the view direction: Fourier series in azimuth, splines over the polar angle."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from math import atan2, pi, radians, sin

import torch
from torch import Tensor

from torchbrdf.lasting import LastFew, lasting, lasting_graph
from torchbrdf.light import LightProbe, texel_coordinates
from torchbrdf.transport.harmonic._bilinear import bilinear
from torchbrdf.transport.harmonic.grid import Zone, zones
from torchbrdf.transport.harmonic.splines import banded_product

LINES = 576
"""Lines of equal polar angle on which radiance is read; twice as many places on each."""

_FINEST = 600 / LINES
"""Rows of texels that a line resolves; larger probes are averaged to so many."""

_BLUR = radians(0.1)
"""See `TurningLight`."""


LightHarmonics = list[tuple[Tensor, Tensor]]
"""Coefficients l of every zone, and i l, each (M, 6, elevations) float32: real parts of R, G and B, then imaginary.

Of K lights at once, (M, 6 K, elevations): real parts of all, then imaginary."""


@dataclass(frozen=True, eq=False)
class TurningLight:
    """A probe whose harmonics are wanted in several orientations.

    lines  of equal polar angle on which radiance is read; at least 270 for all frequencies
    blur   standard deviation, in radians, of a blur along the probe's own rows: it spreads the texels that crowd at
           its poles, which the lines would miss
    grid   the zones whose coefficients are wanted; None for those of libraries
    most   azimuth frequencies that are wanted; None for all of every zone
    """

    probe: LightProbe
    lines: int = LINES
    blur: float = _BLUR
    grid: tuple[Zone, ...] | None = None
    most: int | None = None
    _last: LastFew[tuple[float, ...], "_Turned"] = field(default_factory=lambda: LastFew(1), init=False, repr=False)

    def harmonics(self, rotation: Tensor | None = None) -> LightHarmonics:
        """The coefficients of the probe turned by a rotation (3, 3), as in `LightProbe.rotated`; None for none.

        A turn about the view axis +Z is a phase. Gradients flow to the radiance and to the rotation.
        """
        return [_with_multiple(spectrum) for spectrum in self.spectra(rotation)]

    def spectra(self, rotation: Tensor | None = None) -> list[Tensor]:
        """The same as (3, elevations, M) complex64 for every zone."""
        if rotation is None:
            return self._upright.spectra
        angle = None if rotation.requires_grad else _turn_about_view(rotation)
        if angle is None:
            return self._turned(rotation).spectra
        found = []
        for spectrum in self._upright.spectra:
            phase = -angle * torch.arange(spectrum.shape[2], device=spectrum.device, dtype=torch.float32)
            found.append(spectrum * torch.polar(torch.ones_like(phase), phase))
        return found

    def changes(self, rotation: Tensor) -> LightHarmonics:
        """How they change with further turns about +X, +Y and +Z, per radian: (M, 18, elevations).

        With series L_m(beta) in azimuth, P_m = m cot(beta) L_m - L_m' and N_m = m cot(beta) L_m + L_m', a turn about +X
        adds i/2 (P_{m-1} + N_{m+1}), one about +Y 1/2 (P_{m-1} - N_{m+1}), and one about +Z -i m L_m.
        """
        turned = self._turned(rotation)
        series = turned.series[..., : 2 + max(spectrum.shape[2] for spectrum in turned.spectra)]
        slope = _slope(series)
        beta = (torch.arange(self.lines, dtype=torch.float32, device=series.device) + 0.5) * (pi / self.lines)
        about = torch.arange(series.shape[-1], device=series.device) / torch.tan(beta)[:, None] * series
        up, down = about - slope, about + slope
        before, after = torch.cat([-down[..., 1:2].conj(), up[..., :-2]], -1), down[..., 1:]
        tilted = self._projected(torch.cat([0.5j * (before + after), 0.5 * (before - after)]))
        found = []
        for sideways, spectrum in zip(tilted, turned.spectra, strict=True):
            multiple = torch.arange(spectrum.shape[2], device=spectrum.device) * spectrum.new_tensor(-1j)
            found.append(_with_multiple(torch.cat([sideways[..., : spectrum.shape[2]], spectrum * multiple])))
        return found

    @cached_property
    def _upright(self) -> "_Turned":
        with lasting_graph(self.probe.radiance):
            return self._seen(None)

    def _turned(self, rotation: Tensor) -> "_Turned":
        """Remembered for the last rotation."""
        if rotation.requires_grad or self.probe.radiance.requires_grad:
            return self._seen(rotation)
        return self._last.get_or_make(tuple(rotation.flatten().tolist()), lambda: lasting(self._seen)(rotation))

    @cached_property
    def _texels(self) -> Tensor:
        """(3, H, 2 H + 2) radiance; the first and the last column repeat the one at the other end."""
        with lasting_graph(self.probe.radiance):
            return self._padded()

    def _padded(self) -> Tensor:
        finest = round(self.lines * _FINEST)
        probe = self.probe if self.probe.height <= finest else self.probe.resized(finest)
        radiance, blur = probe.radiance, _blur(probe.height, self.blur, str(probe.device))
        n = len(blur)
        top, middle, bottom = radiance.split([n, probe.height - 2 * n, n], dim=1)
        top, bottom = (
            torch.fft.irfft(torch.fft.rfft(rows) * response, n=probe.width)
            for rows, response in ((top, blur), (bottom, blur.flip(0)))
        )
        spread = torch.cat([top, middle, bottom], 1)
        return torch.cat([spread[..., -1:], spread, spread[..., :1]], -1)

    def _seen(self, rotation: Tensor | None) -> "_Turned":
        height, device = self._texels.shape[1], str(self._texels.device)
        if rotation is None:
            places = _places(height, self.lines, device)
        else:
            turned = _polar_directions(self.lines) @ rotation.to("cpu", torch.float32)  # a row vector times R is R^T d
            places = _places_of(turned, height).to(device)
        seen = bilinear(self._texels, places)
        series = torch.fft.rfft(seen, norm="forward")
        return _Turned(series, self._projected(series))

    def _projected(self, series: Tensor) -> list[Tensor]:
        """(C, elevations, M) complex64 for every zone, of series (C, lines, M)."""
        parts, found = torch.view_as_real(series), []
        for zone in self.grid or zones():
            kept = parts[:, :, : min(zone.frequencies, self.most or zone.frequencies)].flatten(2)
            projected = banded_product(_projection(zone, self.lines, str(series.device)), kept)
            found.append(torch.view_as_complex(projected.unflatten(2, (-1, 2))))
        return found


def together(lights: Sequence[LightHarmonics]) -> LightHarmonics:
    """Those of K lights as of one."""
    return [(_beside([c for c, _ in zone]), _beside([m for _, m in zone])) for zone in zip(*lights, strict=True)]


def _beside(coefficients: list[Tensor]) -> Tensor:
    """(M, 6 K, elevations) of K (M, 6, elevations): real parts of all, then imaginary."""
    return torch.stack(coefficients, 1).unflatten(2, (2, 3)).movedim(2, 1).flatten(1, 3)


@dataclass(frozen=True, eq=False)
class _Turned:
    """A light under one rotation: its series in azimuth (3, lines, M), and the (3, elevations, M) of every zone."""

    series: Tensor
    spectra: list[Tensor]


def _slope(series: Tensor) -> Tensor:
    """Derivatives by the polar angle of series (C, lines, M): differences of fourth order, on beyond the poles."""
    lines, mirrored = series.shape[1], 1 - 2 * (torch.arange(series.shape[2], device=series.device) % 2)
    first, last = (end.flip(1) * mirrored for end in (series[:, :2], series[:, -2:]))
    padded = torch.cat([first, series, last], 1)
    near, far = padded[:, 3:-1] - padded[:, 1:-3], padded[:, 4:] - padded[:, :-4]
    return (8 * near - far) * (lines / (12 * pi))


def _with_multiple(spectrum: Tensor) -> tuple[Tensor, Tensor]:
    real, imaginary = torch.view_as_real(spectrum).permute(3, 2, 0, 1)
    return torch.cat([real, imaginary], 1), torch.cat([-imaginary, real], 1)


def _turn_about_view(rotation: Tensor) -> float | None:
    """The angle of a turn about +Z, from +X towards +Y; None for any other."""
    r = rotation.tolist()
    if max(abs(r[0][2]), abs(r[1][2]), abs(r[2][0]), abs(r[2][1])) > 1e-7 or r[2][2] < 0:
        return None
    return atan2(r[1][0], r[0][0])


@lru_cache(maxsize=2)
@lasting
def _polar_directions(lines: int) -> Tensor:
    """(lines, 2 lines, 3) float32: directions with polar angle beta to +Z and azimuth from +X towards +Y."""
    beta = ((torch.arange(lines, dtype=torch.float64) + 0.5) * (pi / lines))[:, None]
    phi = torch.arange(2 * lines, dtype=torch.float64) * (pi / lines)
    sine = torch.sin(beta)
    axes = [sine * torch.cos(phi), sine * torch.sin(phi), torch.cos(beta).expand(-1, 2 * lines)]
    return torch.stack(axes, dim=-1).float()


def _places_of(directions: Tensor, height: int) -> Tensor:
    """(..., 2): where `grid_sample` finds directions (..., 3), in texels whose ends repeat each other's columns."""
    width = 2 * height
    x, y, _ = texel_coordinates(directions, height, width)
    return torch.stack([(x + 1) * (2 / (width + 1)) - 1, y * (2 / (height - 1)) - 1], -1)


@lru_cache(maxsize=4)
@lasting
def _places(height: int, lines: int, device: str) -> Tensor:
    return _places_of(_polar_directions(lines), height).to(device)


@lru_cache(maxsize=8)
@lasting
def _blur(height: int, deviation: float, device: str) -> Tensor:
    """(N, H + 1): the transform of the blur along the N rows next to a pole where texels are narrower than it.

    The row at the pole itself counts as at a third of a row's distance: bilinear radiance shows it up to the next row.
    """
    step = pi / (height - 1)
    sine = torch.sin(torch.arange(height // 2, dtype=torch.float64) * step)
    narrow = max(1, int((sine < 2 * deviation * height / pi).sum()))
    spread = deviation / sine[:narrow, None].clamp_min(sin(step / 3))
    frequency = torch.arange(height + 1, dtype=torch.float64)
    return torch.exp(-0.5 * (frequency * spread).square()).float().to(device)


@lru_cache(maxsize=16)
@lasting
def _projection(zone: Zone, lines: int, device: str) -> Tensor:
    return zone.light_projection(lines).to(device)
