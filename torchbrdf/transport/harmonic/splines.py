"""Cubic B-splines on uniform knots: 0, 1, ..., n, with n + 3 functions that overlap the ends."""

import torch
from torch import Tensor

SUPPORT = 4
"""Functions that are not zero at a point, and knot intervals that a function covers."""


_BAND_ROWS = 64
"""Rows of a banded matrix that are multiplied together."""


def spline_weights(x: Tensor) -> Tensor:
    """(..., 4): the values at x of the four functions that are not zero there, from number floor(x) on."""
    t = x - torch.floor(x)
    s = 1 - t
    inner = [(4 - 6 * a.square() + 3 * a**3) / 6 for a in (t, s)]
    return torch.stack([s**3 / 6, inner[0], inner[1], t**3 / 6], dim=-1)


def design_matrix(x: Tensor, n: int) -> Tensor:
    """(N, n + 3) float64: all functions at N places x in [0, n]."""
    x = x.double().clamp(0, n)
    first = x.floor().clamp_max(n - 1)
    t = x - first
    weights = spline_weights(torch.where(t < 1, t, 0.0))
    weights = torch.where((t < 1)[:, None], weights, weights.roll(1, -1))  # x = n: the last interval's right end
    matrix = torch.zeros(len(x), n + SUPPORT - 1, dtype=torch.float64, device=x.device)
    return matrix.scatter_(1, first.long()[:, None] + torch.arange(SUPPORT, device=x.device), weights)


def banded_product(matrix: Tensor, values: Tensor) -> Tensor:
    """(..., R, N) = (R, K) @ (..., K, N), of a matrix whose rows are zero but for a band that moves along."""
    found = []
    for rows in matrix.split(_BAND_ROWS):
        touched = torch.nonzero((rows != 0).any(0)).ravel()
        near = slice(int(touched[0]), int(touched[-1]) + 1) if len(touched) else slice(0, 1)
        found.append(rows[:, near] @ values[..., near, :])
    return torch.cat(found, -2)


def gram(design: Tensor, measure: Tensor) -> Tensor:
    """(n + 3, n + 3): inner products of the splines.

    design   (N, n + 3)  of `design_matrix`, at the places of a quadrature
    measure  (N,)        its weights
    """
    return design.T @ (design * measure[:, None])


def banded_dual(products: Tensor, reach: int) -> Tensor:
    """(n + 3, n + 3): what turns moments of a function with the splines into coefficients of a spline like it.

    products  their `gram`; its inverse would give the spline next to the function, but decays slowly off its diagonal
    reach     places off the diagonal of the result, twice that at the ends; cubic polynomials are kept exactly
    """
    n = len(products)
    x = torch.linspace(-1, 1, n, dtype=products.dtype)
    cubics = torch.linalg.qr(torch.stack([x**k for k in range(4)], 1))[0]  # the coefficients of a cubic are one, too
    scale = products.diagonal().rsqrt()
    scaled = products * scale[:, None] * scale
    first = (torch.arange(n) - reach).clamp_max(n - 2 * reach - 1).clamp_min(0)
    near = first[:, None] + torch.arange(min(2 * reach + 1, n))
    normal = (scaled @ scaled.T)[near[:, :, None], near[:, None]]
    exact = (products @ cubics * scale[:, None])[near]
    system = torch.cat([torch.cat([normal, exact], 2), torch.cat([exact.mT, exact.new_zeros(n, 4, 4)], 2)], 1)
    goal = torch.cat([scaled.gather(1, near), cubics / scale[:, None]], 1)
    row = torch.linalg.solve(system, goal)[:, : near.shape[1]]
    dual = torch.zeros_like(products).scatter_(1, near, row)
    return dual * scale[:, None] * scale
