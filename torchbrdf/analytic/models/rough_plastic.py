"""A coloured diffuse base below a rough dielectric coat, as Mitsuba's `roughplastic` evaluates it.

What the coat lets through is a table over the cosine, and what it sends back down one number; both are means over the
visible facets of GGX [Hei18], at Mitsuba's cosines and nodes. In the second, F has a kink at the critical angle: the
sum over nodes is uneven in roughness and index, its slopes by a few percent. Autograd gives those of a smoother
estimate; fits that take differences see the uneven ones.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache
from math import exp, log, pi

import numpy as np
import torch
from torch import Tensor

from torchbrdf.analytic import fresnel
from torchbrdf.analytic.microfacet import ggx_distribution, ggx_unmasked, ggx_visibility
from torchbrdf.analytic.model import ALPHA, DIFFUSE, WEIGHT, AnalyticModel, Parameter
from torchbrdf.analytic.shading_geometry import ShadingGeometry

_COSINES = 64
_NODES_OUTSIDE, _NODES_INSIDE = 32, 128
_BLOCK = 8
"""Cosines at a time: what is computed of them fits a cache."""

_TINY = 1e-12

_BINS = 8192
"""Of the cosine between light from inside and a facet."""

_SMOOTHEST = 1e-3
_STEPS = 32
"""From there to alpha = 1, equal in its logarithm; beyond both ends, what is sent back stays as it is."""


def rough_plastic(
    geometry: ShadingGeometry, diffuse: Tensor, specular: Tensor, eta: Tensor, roughness: Tensor
) -> Tensor:
    """f_r = specular D F G / (4 cos theta_i cos theta_o) + diffuse T(theta_i) T(theta_o) / (pi eta^2 (1 - R)).

    GGX with separable Smith and the exact F; T is what the coat transmits from outside, R what it reflects of diffuse
    light from inside. Second derivatives by eta and roughness are not those of T and R.

    diffuse, specular  reflectance of the base, and weight of the coat's reflection
    eta                index of refraction of the inside over that of the outside, above 1
    roughness          alpha

    Source: Mitsuba 3's `roughplastic` with distribution "ggx" and nonlinear = false.
    """
    lobe = ggx_distribution(geometry, roughness) * ggx_visibility(geometry, roughness)
    f_r = specular * (fresnel.dielectric(geometry.cos_d, eta) * lobe)
    coat = torch.broadcast_tensors(*torch.atleast_2d(eta, roughness))
    table = _transmitted(*coat)
    through = _looked_up(table, geometry.cos_i) * _looked_up(table, geometry.cos_o)
    return f_r + diffuse * (through / (pi * eta.square() * (1 - _sent_back(*coat))))


def _cosines(like: Tensor) -> Tensor:
    return torch.linspace(0, 1, _COSINES, dtype=like.dtype, device=like.device).clamp_min(1e-6)[:, None]


def _transmitted(eta: Tensor, roughness: Tensor) -> Tensor:
    """T at `_COSINES` cosines from 0 to 1, (..., 64), to first order in eta and roughness.

    The derivatives are computed along with the values and only then applied: however many tangents are followed, the
    integrals are taken once.
    """
    at = [value.detach()[..., None, None].expand(*value.shape, _COSINES, 1) for value in (eta, roughness)]
    value, pull = torch.func.vjp(_let_through, *at)  # type: ignore[misc]
    slopes = pull(torch.ones_like(value))
    for parameter, slope in zip((eta, roughness), slopes, strict=True):
        value = value + slope * (parameter - parameter.detach())[..., None, None]
    return value.squeeze(-1)


def _let_through(eta: Tensor, roughness: Tensor) -> Tensor:
    """Mean of (1 - F) G1 over the facets that light from outside meets, at each cosine: (..., 64, 1)."""
    mu = _cosines(eta)
    cos_d, m_z, weights = _visible_facets(mu, roughness, _NODES_OUTSIDE)
    cos_t = (1 - (1 - cos_d.square()) / eta.square()).clamp_min(_TINY).sqrt()
    downwards = mu / eta - (cos_d / eta - cos_t) * m_z
    return ((1 - _fresnel(cos_d, cos_t, eta)) * _seen(downwards, roughness)) @ weights


def _sent_back(eta: Tensor, roughness: Tensor) -> Tensor:
    """R (...): the share of diffuse light from inside that the coat reflects, mean of F G1 over cosines and facets."""
    smooth = _sent_back_smoothly(eta, roughness)
    index, alpha = (value.detach()[..., None, None] for value in (eta, roughness))
    total = torch.zeros_like(smooth.detach())
    for mu in _cosines(eta).split(_BLOCK):
        cos_d, m_z, weights = _visible_facets(mu, alpha, _NODES_INSIDE)
        cos2_t = 1 - (1 - cos_d.square()) * index.square()
        f = torch.where(cos2_t > 0, _fresnel(cos2_t.clamp_min(_TINY).sqrt(), cos_d, index), 1)
        total = total + (mu * ((f * _seen(2 * cos_d * m_z - mu, alpha)) @ weights)).sum((-2, -1))
    return total * (2 / _COSINES) + (smooth - smooth.detach())


def _sent_back_smoothly(eta: Tensor, roughness: Tensor) -> Tensor:
    """About R.

    Of all facets, only the cosine between them and the light matters to F: how their weights G1 are spread over it
    depends on roughness alone, and is tabulated.
    """
    mass, moment = (table.to(eta) for table in _facet_cosines())
    place = (torch.log(roughness) - log(_SMOOTHEST)).clamp(0, -log(_SMOOTHEST)) * (_STEPS / -log(_SMOOTHEST))
    blend = _cubic(place[..., None] - torch.arange(-1, _STEPS + 2, dtype=eta.dtype, device=eta.device))
    weight = blend @ mass
    first = torch.arange(_BINS, dtype=eta.dtype, device=eta.device) / _BINS
    some = weight > _TINY
    cosine = torch.where(some, blend @ moment / torch.where(some, weight, 1), first)
    cosine = torch.minimum(torch.maximum(cosine, first), first + 1 / _BINS).clamp_min(0.5 / _BINS)

    # cos theta_t = sqrt(x), or 0 beyond the critical angle, in the mean over a bin
    eta = eta[..., None]
    x = 1 - (1 - cosine.square()) * eta.square()
    half = cosine * eta.square() / _BINS
    ends = ((x + sign * half).clamp_min(_TINY) for sign in (1, -1))
    upper, lower = (end * end.sqrt() for end in ends)
    cos_t = (upper - lower) / (3 * half)
    return (weight * _fresnel(cos_t, cosine, eta)).sum(-1)


def _cubic(distance: Tensor) -> Tensor:
    """Weights of equally spaced samples in cubic interpolation, by their distance in samples [Key81, eq. 15]."""
    d = distance.abs()
    near = (1.5 * d - 2.5) * d.square() + 1
    far = ((-0.5 * d + 2.5) * d - 4) * d + 2
    return torch.where(d < 1, near, torch.where(d < 2, far, 0))


def _kept(function: Callable[..., tuple[Tensor, ...]]) -> Callable[..., tuple[Tensor, ...]]:
    """A cache of plain tensors. Transforms of torch.func wrap what is made below them, but only in their own thread."""

    @lru_cache(maxsize=2)
    def kept(*arguments: int) -> tuple[Tensor, ...]:
        with ThreadPoolExecutor(1) as pool:
            return pool.submit(function, *arguments).result()

    return kept


@_kept
def _facet_cosines() -> tuple[Tensor, Tensor]:
    """Sums of weights, and of weights times cosines, in bins of the cosine, at each roughness: (35, 8192) float64."""
    mass, moment = (torch.zeros(_STEPS + 3, _BINS, dtype=torch.float64) for _ in range(2))
    for row in range(_STEPS + 3):
        roughness = torch.tensor(exp(log(_SMOOTHEST) * (1 - (row - 1) / _STEPS)), dtype=torch.float64)
        for mu in _cosines(roughness).split(_BLOCK):
            cosine, m_z, weights = _visible_facets(mu, roughness, _NODES_INSIDE)
            share = _seen(2 * cosine * m_z - mu, roughness) * weights[:, 0] * mu * (2 / _COSINES)
            bins = (cosine * _BINS).long().clamp_max(_BINS - 1).flatten()
            mass[row] += torch.bincount(bins, share.flatten(), _BINS)
            moment[row] += torch.bincount(bins, (share * cosine).flatten(), _BINS)
    return mass, moment


def _fresnel(outside: Tensor, inside: Tensor, eta: Tensor) -> Tensor:
    """F, the same from both sides, of the cosines on either side of a boundary."""
    dense_in, dense_out = eta * inside, eta * outside
    across = (outside - dense_in) / (outside + dense_in)
    along = (dense_out - inside) / (dense_out + inside)
    return (across.square() + along.square()) / 2


def _seen(cosine: Tensor, roughness: Tensor) -> Tensor:
    """G1 of GGX, 0 below the horizon [WMLT07, eq. 34]."""
    cosine = cosine.clamp_min(0)
    return cosine / ggx_unmasked(cosine, roughness)


def _visible_facets(mu: Tensor, roughness: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """cos theta_d and m_z of facets m seen from a direction of cosine mu, and weights (n, 1) that sum to 1 [Hei18].

    m_y and -m_y count alike: only half of the nodes are there.
    """
    height, y, weights = (values.to(mu) for values in _disk(count))
    squared = roughness.square()
    length = (squared * (1 - mu.square()) + mu.square()).sqrt()  # of the direction, stretched
    cosine = mu / length
    sine = roughness * (1 - mu.square()).sqrt() / length
    share = (1 + cosine) / 2
    y = height * (1 - share) + share * y
    z = (height.square() - y.square()).clamp_min(_TINY).sqrt()
    m_z = sine * y + cosine * z
    norm = (squared + (1 - squared) * m_z.square()).rsqrt()
    return length * z * norm, m_z * norm, weights


@_kept
def _disk(count: int) -> tuple[Tensor, Tensor, Tensor]:
    """sqrt(1 - x^2) and y of Gauss-Legendre nodes of the square on the unit disk [SC97], x > 0, and weights (n, 1)."""
    nodes, weights = map(torch.from_numpy, np.polynomial.legendre.leggauss(count))
    across, along = (grid.flatten() for grid in torch.meshgrid(nodes[nodes > 0], nodes, indexing="ij"))
    wide = across.abs() >= along.abs()
    radius = torch.where(wide, across, along)
    angle = torch.where(wide, pi / 4 * along / across, pi / 2 - pi / 4 * across / along)
    products = weights[nodes > 0][:, None] * weights / 2
    return (1 - (radius * torch.cos(angle)).square()).sqrt(), radius * torch.sin(angle), products.flatten()[:, None]


def _looked_up(table: Tensor, cosine: Tensor) -> Tensor:
    """The table (*batch, 1, C, 64) over cosines from 0 to 1 at those of (..., 1): (*batch, ..., C), linear."""
    position = cosine.flatten() * (_COSINES - 1)
    index = position.long().clamp_max(_COSINES - 2)
    part = position - index
    below, above = (table.squeeze(-3).index_select(-1, index + k) for k in (0, 1))
    found = below + part * (above - below)
    return found.movedim(-2, -1).unflatten(-2, cosine.shape[:-1])


MODEL = AnalyticModel(
    "rough-plastic",
    rough_plastic,
    (DIFFUSE, replace(WEIGHT, upper=1.0), Parameter("eta", 1.01, 3.0, 1.5), ALPHA),
    "WMLT07",
    energy_conserving=True,
)
