"""Weighted MERL cells that stand for the light that pixels reflect.

The integral over a pixel's area and over light directions is four-dimensional. Part of a pixel's samples follow
the light: a stratum in proportion to its importance for this pixel, a point in it, and a place in the pixel. The
others follow half vectors: theta_h = u^2 pi/2, MERL's own warp, so that each row of its grid gets equally many.
The balance heuristic joins the two [VG95, sec. 3]. The coordinate that chooses the stratum, or theta_h, is
equidistant; Sobol' points give the three others, as in a Hammersley set, with a random shift per pixel: an
offset for the first, exclusive or with random digits for the others [LL02].
"""

from dataclasses import dataclass, replace
from math import pi

import torch
from torch import Tensor

from torchbrdf.brdf import GRID
from torchbrdf.light import SIDE, LightStrata
from torchbrdf.transport._importance import Lobes, stratum_importance
from torchbrdf.transport._vectors import cross, dot
from torchbrdf.view import SurfacePoints, View

DIGITS = 24
"""Binary digits of the random numbers: as many as a float32 holds."""

LEAST = 8
"""Samples a pixel that `TransportSampler.draw` needs at least."""

_HALF_VECTORS = 3
"""Of eight samples, how many follow half vectors."""

_TINY = 1e-12


@dataclass(frozen=True)
class TransportSamples:
    """The linear map from the cells of a table to the radiance of some pixels.

    cells    (Q, S)     int32, flat MERL cells
    weights  (3, Q, S)  float32, sr times the radiance of the light: radiance is the sum of weight times f_r
    """

    cells: Tensor
    weights: Tensor


@dataclass(frozen=True)
class TransportSampler:
    """Draws the samples of any pixels of one view under one light.

    points  (3, N)  int32, Sobol' points in units of 2^-DIGITS, N a power of two
    shifts  (P, 8)  int32 in [0, 2^DIGITS): for each half of the samples one offset and three masks of digits
    """

    strata: LightStrata
    view: View
    points: Tensor
    shifts: Tensor

    @classmethod
    def build(cls, strata: LightStrata, view: View, most: int, generator: torch.Generator) -> "TransportSampler":
        """most: samples a pixel at most, a power of two; the generator (on the CPU) makes all that is random."""
        seed = int(torch.randint(0, 2**31, (1,), generator=generator))
        engine = torch.quasirandom.SobolEngine(3, scramble=True, seed=seed)
        drawn = engine.draw(most, dtype=torch.float64)
        drawn[0] = drawn[0].float()  # the engine makes the first point in torch's default type
        points = (drawn.T * 2**DIGITS).to(torch.int32).contiguous()
        device = strata.share.device
        return cls(strata, view, points.to(device), _random_shifts(len(view.pixels), generator).to(device))

    def reshifted(self, generator: torch.Generator) -> "TransportSampler":
        """The same with independent random shifts."""
        return replace(self, shifts=_random_shifts(len(self.shifts), generator).to(self.shifts.device))

    def draw(self, chosen: Tensor, samples: int, lobes: Lobes) -> TransportSamples:
        """Samples of some pixels.

        chosen   (Q,)  int64, which of the pixels under the mask
        samples  S, a power of two of at least LEAST
        """
        device = chosen.device
        pixels = self.view.pixels.to(device)[chosen]
        shifts = self.shifts[chosen]
        n_half = _HALF_VECTORS * samples // 8
        n_light = samples - n_half
        importance = stratum_importance(self.strata, lobes, self.view, pixels)
        by_light = self._light_samples(pixels, shifts[:, :4], importance, n_light, n_half)
        by_half = self._half_vector_samples(pixels, shifts[:, 4:], importance, n_light, n_half)
        return TransportSamples(
            torch.cat([by_light.cells, by_half.cells], 1), torch.cat([by_light.weights, by_half.weights], 2)
        )

    def _numbers(self, shifts: Tensor, n: int) -> tuple[Tensor, Tensor]:
        """The equidistant coordinate (Q, n) in [0, n), float64, and the others (3, Q, n) as int32."""
        steps = torch.arange(n, dtype=torch.float64, device=shifts.device)
        others = self.points[:, None, :n] ^ shifts.T[1:, :, None]
        return steps + shifts[:, :1] * 2.0**-DIGITS, others

    def _light_samples(
        self, pixels: Tensor, shifts: Tensor, importance: Tensor, n_light: int, n_half: int
    ) -> TransportSamples:
        q, k = importance.shape
        x, numbers = self._numbers(shifts, n_light)
        ends = importance.double().cumsum(1)
        ends = ends * (n_light / ends[:, -1:].clamp_min(1e-300))  # in samples
        begins = torch.nn.functional.pad(ends[:, :-1], (1, 0))
        last = torch.ceil(ends - x[:, :1]).clamp_(0, n_light)
        last[:, -1] = n_light
        counts = torch.diff(last, dim=1, prepend=torch.zeros_like(last[:, :1])).long()
        pairs = torch.arange(q * k, dtype=torch.int32, device=pixels.device)
        pair = torch.repeat_interleave(pairs, counts.reshape(-1), output_size=q * n_light)

        expected = (ends - begins).clamp_min_(1e-300)
        into = (x.reshape(-1) - begins.reshape(-1).index_select(0, pair)).float()
        into *= (SIDE / expected).float().reshape(-1).index_select(0, pair)
        row = into.to(torch.int32).clamp_(0, SIDE - 1).view(q, n_light)
        column = (numbers[0] * SIDE) >> DIGITS
        stratum = pair.view(q, n_light) - pairs[::k, None]
        point = (stratum * SIDE).add_(row).mul_(SIDE).add_(column).reshape(-1)

        strata = self.strata
        w_i = strata.directions.index_select(1, point).view(3, q, n_light)
        radiance = strata.radiance.index_select(1, point).view(3, q, n_light)
        per_density = (expected / strata.share).float().reshape(-1).index_select(0, pair)
        density = strata.density.index_select(0, point).mul_(per_density).view(q, n_light)
        place = numbers[1:].float() * 2.0**-DIGITS
        seen = self._reflection(self.view.surface(pixels, place[0], place[1]), w_i)
        return seen.weigh(radiance, density.add_(seen.half_vector_density, alpha=n_half))

    def _half_vector_samples(
        self, pixels: Tensor, shifts: Tensor, importance: Tensor, n_light: int, n_half: int
    ) -> TransportSamples:
        q, k = importance.shape
        x, numbers = self._numbers(shifts, n_half)
        azimuth, u, v = numbers.float() * 2.0**-DIGITS
        points = self.view.surface(pixels, u, v)
        theta_h = (x / n_half).float().square_().mul_(pi / 2)
        w_i = _mirrored(points.normals, points.view_dirs, theta_h, azimuth.mul_(2 * pi))
        radiance, density, stratum = self.strata.seen(w_i)
        total = importance.sum(1, keepdim=True).clamp_min(1e-30)
        per_density = (importance * (n_light / total)).div_(self.strata.share).float()
        stratum += torch.arange(0, q * k, k, dtype=torch.int32, device=pixels.device)[:, None]
        density *= per_density.reshape(-1).index_select(0, stratum.reshape(-1)).view(q, n_half)
        seen = self._reflection(points, w_i)
        return seen.weigh(radiance, density.add_(seen.half_vector_density, alpha=n_half))

    def _reflection(self, points: SurfacePoints, w_i: Tensor) -> "Reflection":
        seen = reflection(points.normals, points.view_dirs, w_i)
        lit = self.view.visibility(points, w_i)
        return seen if lit is None else replace(seen, cos_i=seen.cos_i * lit)


def _random_shifts(n: int, generator: torch.Generator) -> Tensor:
    return torch.randint(0, 2**DIGITS, (n, 8), generator=generator, dtype=torch.int32)


@dataclass(frozen=True)
class Reflection:
    """Direction pairs about normals in world space, all (Q, S).

    cells                int32, flat MERL cells
    cos_i                max(0, cos(theta_i)); 0 (and cell 0) where either direction is below the horizon
    half_vector_density  1/sr, over w_i, of half vectors with theta_h = u^2 pi/2
    """

    cells: Tensor
    cos_i: Tensor
    half_vector_density: Tensor

    def weigh(self, radiance: Tensor, density: Tensor) -> TransportSamples:
        """Weights of samples, given their radiance (3, Q, S) and the expected number of samples a sr (Q, S)."""
        return TransportSamples(self.cells, radiance * (self.cos_i / density))


def reflection(n: Tensor, w_o: Tensor, w_i: Tensor) -> Reflection:
    """Cell, cosine and density of unit vectors (3, Q, S): normals, directions to the camera and to the light.

    As `half_difference`, without a local frame. With s = w_i + w_o = 2 cos(theta_d) h: the part of s normal to n
    gives theta_h without cancellation; phi_d = atan2(2 n.(w_o x w_i) / |s|, cos_o - cos_i). Half vectors with
    uniform u = sqrt(theta_h 2 / pi) have p(h) = 1 / (2 pi^2 u sin(theta_h)), and p(w_i) = p(h) / (4 cos(theta_d)).
    """
    cos_i, cos_o = dot(n, w_i), dot(n, w_o)
    cos_s = cos_i + cos_o
    s = w_i + w_o
    length = torch.sqrt(dot(s, s)).clamp_min_(_TINY)
    across = [torch.addcmul(s[axis], cos_s, n[axis], value=-1) for axis in range(3)]
    sin_s = torch.sqrt(dot(across, across))
    u = torch.atan2(sin_s, cos_s).clamp_min_(0).mul_(2 / pi).sqrt_()
    density = (u * sin_s).mul_(4 * pi * pi).clamp_min_(_TINY).reciprocal_()
    row = u.mul_(GRID[0]).to(torch.int32).clamp_(0, GRID[0] - 1)
    theta_d = torch.acos((0.5 * length).clamp_max_(1))
    column = theta_d.mul_(GRID[1] * 2 / pi).to(torch.int32).clamp_(0, GRID[1] - 1)
    sine = dot(n, cross(w_o, w_i)).mul_(2)
    phi_d = torch.atan2(sine, (cos_o - cos_i).mul_(length)).mul_(GRID[2] / pi)
    phi_d = torch.where(phi_d < 0, phi_d + GRID[2], phi_d)
    visible = (cos_i > 0) & (cos_o > 0)
    cells = row.mul_(GRID[1]).add_(column).mul_(GRID[2])
    cells = cells.add_(phi_d.to(torch.int32).clamp_(0, GRID[2] - 1)).mul_(visible)
    return Reflection(cells, cos_i.mul_(visible), density)


def _mirrored(normal: Tensor, w_o: Tensor, theta_h: Tensor, phi_h: Tensor) -> Tensor:
    """The light directions (3, Q, S) whose half vectors stand at theta_h, phi_h (Q, S) about the normals."""
    t, b = _tangents(normal)
    sin_h = torch.sin(theta_h)
    h = torch.cos(theta_h) * normal
    h.addcmul_(sin_h * torch.cos(phi_h), t).addcmul_(sin_h.mul_(torch.sin(phi_h)), b)
    return h.mul_(2 * dot(h, w_o)).sub_(w_o)


def _tangents(n: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit vectors (3, ...) orthogonal to unit vectors n (3, ...) and to each other [DBCHKLV17]."""
    sign = 2 * (n[2] >= 0).to(n) - 1
    a = -1 / (sign + n[2])
    c = n[0] * n[1] * a
    t = torch.stack([1 + sign * n[0] * n[0] * a, sign * c, -sign * n[0]])
    return t, torch.stack([c, sign + n[1] * n[1] * a, -n[1]])
