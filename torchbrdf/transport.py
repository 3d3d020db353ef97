"""Light transport between a probe and a view: basis images [CBP21, eq. 5] and renderings of one table.

For every pixel a fixed set of weighted MERL cells stands for the integral over light directions and over the
pixel's area: radiance = sum_s weight_s f_r(cell_s). Basis images gather rows of B by those cells; a rendering of
one table gathers its values. Half of the samples follow the light, half the half vectors of MERL's own grid;
the balance heuristic joins them [VG95].
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import pi

import torch
from torch import Tensor
from tqdm import tqdm

from torchbrdf.basis_images import BasisImages
from torchbrdf.library import MaterialLibrary
from torchbrdf.merl import MerlTable, cell_index
from torchbrdf.probe import LightProbe
from torchbrdf.view import View

DEFAULT_SAMPLES = 2048
"""Samples a pixel, half along the light and half along half vectors."""

_BLOCK = 1 << 18
"""Samples worked on at once on a CPU: their arrays stay in its cache."""

_TINY = 1e-20


@dataclass(frozen=True)
class TransportSamples:
    """The linear map from the cells of a table to the radiance of some pixels.

    cells    (Q, S)     int32, flat MERL cells
    weights  (3, Q, S)  float32, sr times the radiance of the light: radiance is the sum of weight times f_r
    """

    cells: Tensor
    weights: Tensor


def render_basis(
    library: MaterialLibrary,
    probe: LightProbe,
    view: View,
    backend: str = "sampled",
    samples: int = DEFAULT_SAMPLES,
    seed: int = 0,
    progress: bool = False,
) -> BasisImages:
    """Images Y of every basis BRDF under a probe [CBP21, eq. 5].

    Runs on the device that holds the library's columns. Only pixels under the view's mask are computed and only
    cells that samples touch are read. `samples` are per pixel. Raises ValueError for an unknown backend.
    """
    if backend != "sampled":
        raise ValueError(f'backend must be "sampled", got {backend!r}')
    columns, scale = library.stored.columns, library.stored.scale
    device = columns.device
    packed = torch.empty(3, len(view.pixels), columns.shape[1], device=device)
    with tqdm(total=len(view.pixels), desc="basis images", unit="px", disable=not progress, leave=False) as bar:
        for pixels, transport in transport_blocks(probe, view, samples, seed, device):
            packed[:, pixels] = _gather_columns(transport, columns)
            bar.update(transport.cells.shape[0])
    packed = (packed * scale.to(device, torch.float32))[..., library.column_index.to(device)]
    return BasisImages(
        packed=packed.permute(2, 0, 1).contiguous(),
        mask=view.mask,
        names=library.names,
        library=library.source,
        probe=probe.fingerprint,
        view=view.fingerprint,
        description=f"{backend}, {samples} samples a pixel, seed {seed}",
    )


def render(
    table: MerlTable, probe: LightProbe, view: View, samples: int = DEFAULT_SAMPLES, seed: int = 0
) -> Tensor:
    """Radiance (3, H, W) of a view whose material is `table`, 0 outside the mask.

    Runs on the device of the probe. With equal samples and seed it uses the same transport as `render_basis`.
    """
    values = table.filled.to(probe.device, torch.float32)
    packed = torch.empty(3, len(view.pixels), device=probe.device)
    for pixels, transport in transport_blocks(probe, view, samples, seed, probe.device):
        f_r = values[transport.cells.reshape(-1).long()].reshape(*transport.cells.shape, 3)
        packed[:, pixels] = torch.einsum("cqs,qsc->cq", transport.weights, f_r)
    return view.unpack(packed)


def transport_blocks(
    probe: LightProbe, view: View, samples: int, seed: int, device: torch.device
) -> Iterator[tuple[slice, TransportSamples]]:
    """The transport of all pixels, a block at a time: which pixels (among those under the mask) and their samples."""
    if samples < 2:
        raise ValueError(f"the transport needs at least 2 samples a pixel, got {samples}")
    pixels = view.pixels
    generator = torch.Generator().manual_seed(seed)
    shift = torch.rand(len(pixels), 8, generator=generator)
    block = max(1, (_BLOCK if device.type == "cpu" else 64 * _BLOCK) // samples)
    probe = probe.to(device)
    points = _kronecker_points(samples - samples // 2).to(device)
    for start in range(0, len(pixels), block):
        chunk = slice(start, start + block)
        yield chunk, sample_transport(probe, view, pixels[chunk].to(device), shift[chunk].to(device), points, samples)


def _kronecker_points(n: int) -> Tensor:
    """(n, 4) points of the R4 sequence: low-discrepancy, one additive step an axis [Rob18]."""
    root = 1.1673039782614187  # the real root of x^5 = x + 1
    steps = torch.tensor([root**-k for k in range(1, 5)], dtype=torch.float64)
    return torch.remainder(torch.arange(1, n + 1, dtype=torch.float64)[:, None] * steps, 1).float()


def sample_transport(
    probe: LightProbe, view: View, pixels: Tensor, shift: Tensor, points: Tensor, samples: int
) -> TransportSamples:
    """Weighted cells of some pixels.

    pixels   (Q,)    flat indices under the view's mask
    shift    (Q, 8)  in [0, 1): a random shift of the points per pixel, four for each half of the samples
    points   (S', 4) in [0, 1): two coordinates inside the pixel, two for the light direction
    """
    n_half = samples // 2
    n_light = samples - n_half
    light = _SurfacePoint.at(view, pixels, points[:n_light], shift[:, :4])
    by_light = _light_samples(probe, light, n_light, n_half)
    half = _SurfacePoint.at(view, pixels, points[:n_half], shift[:, 4:])
    by_half = _half_vector_samples(probe, half, n_light, n_half)
    return TransportSamples(
        torch.cat([by_light.cells, by_half.cells], dim=1), torch.cat([by_light.weights, by_half.weights], dim=2)
    )


@dataclass(frozen=True)
class _SurfacePoint:
    """Points of the surface inside pixels: vectors are (3, Q, S); u, v (Q, S) are for choosing a light direction."""

    normal: Tensor
    w_o: Tensor
    u: Tensor
    v: Tensor

    @classmethod
    def at(cls, view: View, pixels: Tensor, points: Tensor, shift: Tensor) -> "_SurfacePoint":
        numbers = torch.remainder(points.T[:, None, :] + shift.T[:, :, None], 1)
        normal, w_o = view.surface(pixels, numbers[0], numbers[1])
        return cls(normal, w_o, numbers[2], numbers[3])


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _light_samples(probe: LightProbe, at: _SurfacePoint, n_light: int, n_half: int) -> TransportSamples:
    directions, pdf_light = probe.sample(torch.stack([at.u, at.v], dim=-1))
    radiance = probe.radiance_at(directions)
    w_i = directions.movedim(-1, 0)
    geometry = _HalfVectorGeometry.of(at, w_i)
    return _weigh(geometry, radiance, n_light * pdf_light + n_half * geometry.pdf())


def _half_vector_samples(probe: LightProbe, at: _SurfacePoint, n_light: int, n_half: int) -> TransportSamples:
    """Half vectors with theta_h = u^2 pi/2, MERL's own warp: each theta_h row of the grid gets equally many."""
    theta_h, phi_h = at.u * at.u * (pi / 2), at.v * (2 * pi)
    sin_h = torch.sin(theta_h)
    t, b = _tangents(at.normal)
    h = (sin_h * torch.cos(phi_h)) * t + (sin_h * torch.sin(phi_h)) * b + torch.cos(theta_h) * at.normal
    w_i = (2 * _dot(h, at.w_o)) * h - at.w_o
    geometry = _HalfVectorGeometry.of(at, w_i)
    directions = w_i.movedim(0, -1).contiguous()
    pdf_light = probe.pdf(directions)
    radiance = probe.radiance_at(directions)
    return _weigh(geometry, radiance, n_light * pdf_light + n_half * geometry.pdf())


def _tangents(n: Tensor) -> tuple[Tensor, Tensor]:
    """Two unit vectors (3, ...) orthogonal to unit vectors n (3, ...) and to each other [DBCKLMV17]."""
    sign = torch.where(n[2] >= 0, 1.0, -1.0)
    a = -1 / (sign + n[2])
    c = n[0] * n[1] * a
    t = torch.stack([1 + sign * n[0] * n[0] * a, sign * c, -sign * n[0]])
    b = torch.stack([c, sign + n[1] * n[1] * a, -n[1]])
    return t, b


@dataclass(frozen=True)
class _HalfVectorGeometry:
    """Angles of direction pairs about normals in world space; see directions.py for the local frame."""

    cos_i: Tensor
    cos_o: Tensor
    theta_h: Tensor
    sin_h: Tensor
    theta_d: Tensor
    cos_d: Tensor
    phi_d: Tensor

    @classmethod
    def of(cls, at: _SurfacePoint, w_i: Tensor) -> "_HalfVectorGeometry":
        n, w_o = at.normal, at.w_o
        cos_i, cos_o = _dot(n, w_i), _dot(n, w_o)
        s = w_i + w_o  # 2 cos(theta_d) h
        length = torch.sqrt(_dot(s, s)).clamp_min(_TINY)
        d = w_i - w_o
        cross = torch.stack([n[1] * s[2] - n[2] * s[1], n[2] * s[0] - n[0] * s[2], n[0] * s[1] - n[1] * s[0]])
        sin_h = torch.sqrt(_dot(cross, cross)) / length
        theta_h = torch.atan2(sin_h, (cos_i + cos_o) / length)
        theta_d = torch.atan2(torch.sqrt(_dot(d, d)), length)
        phi_d = torch.atan2(_dot(cross, d) / length, cos_o - cos_i)
        return cls(cos_i, cos_o, theta_h, sin_h, theta_d, 0.5 * length, phi_d)

    def pdf(self) -> Tensor:
        """Density over solid angle of the directions that `_half_vector_samples` chooses.

        u = sqrt(theta_h 2 / pi) is uniform, so p(h) = 1 / (pi u 2 pi sin(theta_h)) and p(w_i) = p(h) / (4 cos(theta_d)).
        """
        u = torch.sqrt(self.theta_h * (2 / pi))
        return 1 / (8 * pi * pi * u * self.sin_h * self.cos_d).clamp_min(_TINY)


def _weigh(geometry: _HalfVectorGeometry, radiance: Tensor, density: Tensor) -> TransportSamples:
    visible = (geometry.cos_i > 0) & (geometry.cos_o > 0)
    factor = torch.where(visible, geometry.cos_i / density, 0)
    cells = torch.where(visible, cell_index(geometry.theta_h, geometry.theta_d, geometry.phi_d), 0)
    return TransportSamples(cells, radiance.movedim(-1, 0) * factor)


def _gather_columns(transport: TransportSamples, columns: Tensor) -> Tensor:
    """(3, Q, n) float32: weighted sums of rows of B, in units of the columns' scale.

    The three channels of a pixel stand side by side so that its rows are still in cache for the second and third.
    Weights are divided by a power of two that brings their sum near 1: float16 then loses only its rounding.
    """
    q, s = transport.cells.shape
    cells = transport.cells[:, None].expand(q, 3, s).reshape(-1)
    weights = transport.weights.permute(1, 0, 2)
    unit = torch.exp2(torch.ceil(torch.log2(weights.sum(-1, keepdim=True).clamp_min(_TINY))))
    bags = torch.arange(0, 3 * q * s, s, dtype=cells.dtype, device=cells.device)
    sums = torch.nn.functional.embedding_bag(
        cells, columns, bags, mode="sum", per_sample_weights=(weights / unit).half().reshape(-1)
    )
    return (sums.view(q, 3, -1).float() * unit).permute(1, 0, 2)
