"""Weighted MERL cells that stand for the light a pixel reflects: what the transport gathers.

The integral over a pixel's area and over light directions is four-dimensional. Per pixel, strata of the light
are chosen in proportion to an estimate of what they contribute to glossy and to matt materials (a product of
light, cosine and lobe); then come a point within the stratum and one within the pixel. The choice of stratum and
the first coordinate in it are the equidistant coordinate of a Hammersley set; Sobol' points with a random digital
shift per pixel [LL02] give the others.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import pi

import torch
from torch import Tensor

from torchbrdf.light_strata import GRID, LightStrata
from torchbrdf.merl import GRID as CELLS
from torchbrdf.view import View

_BITS = 24
_LOBE = 0.03
_NARROWEST = 0.01
_LOBE2 = 0.001


@dataclass(frozen=True)
class TransportSamples:
    """The linear map from the cells of a table to the radiance of some pixels.

    cells    (Q, S)     int32, flat MERL cells
    weights  (3, Q, S)  float32, sr times the radiance of the light: radiance is the sum of weight times f_r
    """

    cells: Tensor
    weights: Tensor


def net(n: int, seed: int) -> Tensor:
    """(3, n) int32: scrambled Sobol' points in units of 2^-24."""
    points = torch.quasirandom.SobolEngine(3, scramble=True, seed=seed).draw(n, dtype=torch.float64)
    return (points.T * 2**_BITS).to(torch.int32).contiguous()


def stratum_importance(strata: LightStrata, view: View, pixels: Tensor) -> Tensor:
    """(Q, K) >= 0: about what each stratum adds to each pixel; 0 only where it lies below the horizon."""
    corners = torch.tensor([[0.5, 0.0, 1.0, 0.0, 1.0], [0.5, 0.0, 0.0, 1.0, 1.0]], device=pixels.device)
    normals, view_dirs = view.surface(pixels, *corners[:, None].expand(2, len(pixels), 5))
    normal, w_o = normals[:, :, 0].T, view_dirs[:, :, 0].T
    spread = torch.acos((normals[:, :, :1] * normals).sum(0).amin(1).clamp(-1, 1))[:, None]
    cos_i = normal @ strata.axis.T
    cos_o = (normal * w_o).sum(1, keepdim=True)
    s_squared = (w_o @ strata.axis.T).mul_(2).add_(2.0001)
    reach = 1.05 * spread + strata.radius
    cosine = (cos_i + reach).clamp_min_(0)
    cosine = torch.minimum(cosine, 2 * reach).square_().div_(4 * reach).add_((cos_i - reach).clamp_min_(0))
    sine_squared = 1 - (cos_i + cos_o).square_().div_(s_squared)
    width_squared = (0.25 * strata.radius.square()) / s_squared
    width_squared += (0.5 * spread).square() + _NARROWEST**2
    x = sine_squared.clamp_min_(0).add_(width_squared).reciprocal_()
    lobe = 1 + _LOBE * x + _LOBE2 * x * x
    return cosine * lobe * strata.share.float()


def sample_transport(
    strata: LightStrata, view: View, pixels: Tensor, shift: Tensor, points: Tensor
) -> TransportSamples:
    """Weighted cells of some pixels.

    pixels   (Q,)   flat indices under the view's mask
    shift    (Q, 4) int32 in [0, 2^24): a random shift per pixel
    points   (3, S) int32 in [0, 2^24)
    """
    q, s = len(pixels), points.shape[1]
    k = len(strata.share)
    weight = stratum_importance(strata, view, pixels)
    edges = weight.double().cumsum(1)
    edges *= s / edges[:, -1:]
    offset = shift[:, :1].double() * 2.0**-_BITS
    last = torch.ceil(edges - offset).clamp_(0, s)
    last[:, -1] = s
    counts = torch.diff(last, dim=1, prepend=torch.zeros_like(last[:, :1])).long()
    pair = torch.repeat_interleave(torch.arange(q * k, device=pixels.device), counts.reshape(-1), output_size=q * s)
    begin = torch.nn.functional.pad(edges[:, :-1], (1, 0))
    width = (edges - begin).clamp_min_(1e-300)
    slope = (GRID / width).float()
    x = (torch.arange(s, device=pixels.device) + offset).reshape(-1)  # float64
    column = ((x - begin.reshape(-1).index_select(0, pair)).float() * slope.reshape(-1).index_select(0, pair)).to(torch.int32).clamp_(0, GRID - 1)
    numbers = points[:, None, :] ^ shift.T[1:, :, None]
    row = numbers[0] >> (_BITS - 4)
    stratum = pair.view(q, s) - torch.arange(0, q * k, k, device=pixels.device)[:, None]
    at = (stratum * GRID + column.view(q, s)) * GRID + row
    at = at.reshape(-1)
    u, v = numbers[1:].float() * 2.0**-_BITS
    normal, w_o = view.surface(pixels, u, v)
    scale = (1 / width).float().reshape(-1).index_select(0, pair).view(q, s)
    w_i = strata.directions.T.contiguous().index_select(1, at).view(3, q, s)
    emission = strata.emission.T.contiguous().index_select(1, at).view(3, q, s)
    cells, cos_i = cells_of(normal, w_o, w_i)
    return TransportSamples(cells, emission * (cos_i * scale))


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a[0] * b[0]).addcmul_(a[1], b[1]).addcmul_(a[2], b[2])


def cells_of(n: Tensor, w_o: Tensor, w_i: Tensor) -> tuple[Tensor, Tensor]:
    """Cells (Q, S) int32 and max(0, cos theta_i); cell 0 and cosine 0 where a direction is below the horizon."""
    cos_i, cos_o = _dot(n, w_i), _dot(n, w_o)
    s = w_i + w_o
    cos_s = cos_i + cos_o
    length = torch.sqrt(_dot(s, s)).clamp_min_(1e-12)
    # s minus its part along n
    e = [torch.addcmul(s[i], cos_s, n[i], value=-1) for i in range(3)]
    sin_s = torch.sqrt((e[0] * e[0]).addcmul_(e[1], e[1]).addcmul_(e[2], e[2]))
    row = torch.atan2(sin_s, cos_s).mul_(2 / pi * CELLS[0] ** 2).clamp_min_(0).sqrt_().to(torch.int32).clamp_(0, CELLS[0] - 1)
    d_row = torch.acos((0.5 * length).clamp_max_(1)).mul_(2 * CELLS[1] / pi).to(torch.int32).clamp_(0, CELLS[1] - 1)
    cross = [
        torch.addcmul(w_o[1] * w_i[2], w_o[2], w_i[1], value=-1),
        torch.addcmul(w_o[2] * w_i[0], w_o[0], w_i[2], value=-1),
        torch.addcmul(w_o[0] * w_i[1], w_o[1], w_i[0], value=-1),
    ]
    triple = (cross[0] * n[0]).addcmul_(cross[1], n[1]).addcmul_(cross[2], n[2]).mul_(2)
    phi = torch.atan2(triple, (cos_o - cos_i).mul_(length))
    phi.mul_(CELLS[2] / pi)
    phi = torch.where(phi < 0, phi + CELLS[2], phi).to(torch.int32).clamp_(0, CELLS[2] - 1)
    visible = (cos_i > 0) & (cos_o > 0)
    cells = row.mul_(CELLS[1]).add_(d_row).mul_(CELLS[2]).add_(phi).mul_(visible)
    return cells, cos_i.mul_(visible)
