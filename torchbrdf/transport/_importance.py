"""How much every stratum of the light matters to every pixel, and how much of the work every pixel deserves.

Both follow the materials: a lobe table holds, for each theta_h and theta_d of the MERL grid, the root of the sum
over all columns of f_r^2 / energy of the column's image. Sampling in proportion to it (times light and cosine)
minimises the sum of the relative squared errors of the images, and so does giving a pixel samples in proportion
to the root of its share of that error.
"""

from dataclasses import dataclass
from math import log2, pi

import torch
from torch import Tensor

from torchbrdf.brdf import GRID, cell_centres
from torchbrdf.light import LightStrata
from torchbrdf.transport._vectors import dot
from torchbrdf.view import View

_LEVELS = 6
_FINEST = 0.01
"""Radians: the first blur of the lobes; each level doubles it."""

_FLOOR = 1e-3
"""Least importance of a direction above the horizon, relative to the mean over the table."""

_REPRESENTATIVES = 8


@dataclass(frozen=True)
class Lobes:
    """What directions are worth.

    table  (_LEVELS, 90, 90)  relative importance per theta_h and theta_d, blurred more and more in theta_h
    """

    table: Tensor

    @classmethod
    def unknown(cls, device: torch.device) -> "Lobes":
        """For a first look: falls with theta_h, whatever the material."""
        theta_h = cell_centres(torch.float32)[0].ravel().to(device)
        return cls._blurred(((theta_h + 0.02) ** -2.6)[:, None].expand(GRID[:2]))

    @classmethod
    def of(cls, profiles: Tensor, energy: Tensor) -> "Lobes":
        """For some materials.

        profiles  (90, 90, n)  f_r at phi_d = 90 degrees
        energy    (n,)         sum of the squares of each column's image, float64; 0 leaves a column out
        """
        weight = torch.where(energy > 0, 1 / energy, 0)
        squared = (profiles.double().square() * weight).sum(-1)
        mean = squared.mean()
        return cls._blurred((squared / mean if mean > 0 else torch.ones_like(squared)).float() + _FLOOR**2)

    @classmethod
    def _blurred(cls, squared: Tensor) -> "Lobes":
        """Means of the squares over discs of half vectors, by quadrature; then their root."""
        theta_h = cell_centres(torch.float32)[0].to(squared.device)
        rho = torch.sqrt((torch.arange(8, dtype=torch.float32, device=squared.device) + 0.5) / 8)[:, None]
        cos_phi = torch.cos((torch.arange(8, dtype=torch.float32, device=squared.device) + 0.5) * (pi / 8))
        levels = []
        for level in range(_LEVELS):
            r = _FINEST * 2**level * rho
            theta = torch.sqrt(theta_h**2 + r * r + 2 * theta_h * r * cos_phi)
            rows = (torch.sqrt(theta * (2 / pi)) * GRID[0]).long().clamp(0, GRID[0] - 1)
            levels.append(squared[rows.flatten(1)].mean(1).sqrt())
        return cls(torch.stack(levels).float().contiguous())


def stratum_importance(strata: LightStrata, lobes: Lobes, view: View, pixels: Tensor) -> Tensor:
    """(Q, K) >= 0: about the root of what each stratum adds to the squares of each pixel.

    Light times cosine times lobe, each a mean over the pixel and the stratum. It is 0 only where all points of
    the stratum lie below the horizon of the whole pixel.
    """
    places = [[0.5, 0.0, 1.0, 0.0, 1.0], [0.5, 0.0, 0.0, 1.0, 1.0]]
    corners = torch.tensor(places, dtype=torch.float32, device=pixels.device)
    points = view.surface(pixels, *corners[:, None].expand(2, len(pixels), 5))
    n, w_o = points.normals[..., :1], points.view_dirs[..., :1]
    spread = torch.acos((n * points.normals).sum(0).amin(1, keepdim=True).clamp(-1, 1))
    cos_i, along = dot(n, strata.axis), dot(w_o, strata.axis)  # unlike a matrix product the same for every Q
    reach = 1.05 * spread + strata.radius
    above = (cos_i + reach).clamp_min_(0)
    cosine = torch.minimum(above, 2 * reach).square_().div_(4 * reach).add_((cos_i - reach).clamp_min_(0))

    s_squared = along.mul_(2).add_(2).clamp_min_(1e-4)  # |w_i + w_o|^2 = 4 cos(theta_d)^2
    blur = (0.5 * strata.radius.square()) / s_squared + 0.5 * spread.square()
    level = torch.log2(blur).mul_(0.5).sub_(log2(_FINEST) - 0.5).clamp_(0, _LEVELS - 1).to(torch.int32)
    length = s_squared.sqrt_()
    cos_h = (cos_i + (n * w_o).sum(0)) / length
    row = torch.acos(cos_h.clamp_(0, 1)).mul_(2 / pi).sqrt_().mul_(GRID[0]).to(torch.int32).clamp_(0, GRID[0] - 1)
    theta_d = torch.acos(length.mul_(0.5).clamp_(0, 1))
    column = theta_d.mul_(GRID[1] * 2 / pi).to(torch.int32).clamp_(0, GRID[1] - 1)
    at = level.mul_(GRID[0]).add_(row).mul_(GRID[1]).add_(column)
    lobe = lobes.table.reshape(-1).index_select(0, at.reshape(-1)).view(cosine.shape)
    return lobe.mul_(cosine).mul_(strata.share.float())


def representatives(profiles: Tensor, energy: Tensor) -> Tensor:
    """(8100, m) columns of profiles (90, 90, n), m <= 8, from the flattest to the most peaked for its energy."""
    peak = profiles[0, GRID[1] // 10].double() / energy.sqrt()
    lit = torch.nonzero(energy > 0).ravel()
    order = lit[peak[lit].argsort()]
    chosen = torch.linspace(0, max(len(order) - 1, 0), min(len(order), _REPRESENTATIVES), dtype=torch.float32).long()
    return profiles.flatten(0, 1)[:, order[chosen.to(order.device)]].float().contiguous()


def allocate(variance: Tensor, energy: Tensor, samples: int, least: int, most: int) -> Tensor:
    """Samples a pixel (P,) int64: powers of two in [least, most] whose mean is at most `samples` where it can be.

    variance  (P, m)  of the estimate with one sample, per column
    energy    (m,)    sum of the squares of the column's image
    """
    relative = torch.where(energy > 0, variance.double() / energy, 0).sum(1)
    wanted = relative.sqrt().clamp_min(1e-30).log2()
    first, last = log2(least), log2(most)
    low, high = first - float(wanted.max()) - 1, last - float(wanted.min()) + 1
    for _ in range(40):
        middle = (low + high) / 2
        levels = (wanted + middle).round().clamp(first, last)
        low, high = (middle, high) if float(torch.exp2(levels).mean()) <= samples else (low, middle)
    return torch.exp2((wanted + low).round().clamp(first, last)).long()
