"""Small strictly convex quadratic programs, many at once: the projection of a point on a polyhedron in a metric.

    minimise 1/2 (w - mean)^T H (w - mean)   subject to   w >= 0, at wish with 1^T w = 1,   or   A w >= b

Both are one problem in other clothes, min 1/2 x^T M x - d^T x with x >= 0 (`active_set`): for w >= 0 it is the program
itself, M = H, without its inverse; for rows it is the dual, M = A H^-1 A^T, whose unknowns are the multipliers. Given
the free variables the answer is one linear solve, done once more with gradients: implicit differentiation.
"""

import torch
from torch import Tensor

from torchbrdf.estimation.solvers._active_set import (
    EPS,
    Metric,
    active_set,
    cholesky,
    free_indices,
    grouped,
    power_of_two,
    without_padding,
)

_RIDGE = 1e-13
"""Added to the unit diagonal of M for rows: rows may depend on each other. A row then gives way by this times its
multiplier, in units of its own length."""


def project_nonnegative(
    mean: Tensor, precision: Tensor, group: Tensor, sum_to_one: bool = False
) -> tuple[Tensor, Tensor]:
    """The w >= 0, at wish of sum 1, nearest to the mean in the metric of the precision.

    mean        (N, c)     float64
    precision   (S, c, c)  symmetric positive definite
    group       (N,)       int64: program n has precision[group[n]]
    sum_to_one  bool
    returns     weights (N, c), with gradients to mean and precision; iterations (N,) int64, 0 where the mean itself
                is feasible, which is then returned as it is
    """
    c = mean.shape[1]
    with torch.no_grad():
        inside = (mean >= 0).all(-1)
        if sum_to_one:
            inside &= (mean.sum(-1) - 1).abs() <= EPS * c
        todo = torch.nonzero(~inside).ravel()
        iterations = torch.zeros(len(mean), dtype=torch.int64, device=mean.device)
        if not len(todo):
            return mean, iterations
        scale = power_of_two(precision.diagonal(dim1=-2, dim2=-1).rsqrt())
        matrix = precision * scale[:, :, None] * scale[:, None, :]
        metric = Metric(matrix, group[todo], scale if sum_to_one else None)
        pull = metric.times(mean[todo] / scale[metric.group])
        if sum_to_one:
            start = _best_vertex(metric, pull)
        else:  # few weights stay free on photographs, nearly all where a strong penalty made the mean
            nearly = (mean[todo] < 0).sum(-1, keepdim=True) < c / 8
            start = torch.where(nearly, (mean[todo] / scale[metric.group]).clamp_min(0), 0.0)
        end = active_set(metric, pull, start)
        iterations[todo] = end.iterations
    solved = _solve_free(mean[todo], precision, metric.group, end.free, sum_to_one)
    return (solved if len(todo) == len(mean) else mean.index_copy(0, todo, solved)), iterations


def _best_vertex(metric: Metric, pull: Tensor) -> Tensor:
    """The corner of the simplex with the lowest objective: few weights stay free at the end, so start from one."""
    assert metric.total is not None
    corner = 1 / metric.total[metric.group]
    value = 0.5 * metric.matrix.diagonal(dim1=-2, dim2=-1)[metric.group] * corner**2 - pull * corner
    lowest = value.argmin(-1, keepdim=True)
    return torch.zeros_like(pull).scatter(-1, lowest, corner.gather(-1, lowest))


def _solve_free(mean: Tensor, precision: Tensor, group: Tensor, free: Tensor, sum_to_one: bool) -> Tensor:
    """w with w = 0 outside the free set and the gradient 0 (or constant) on it; differentiable.

    As a change of the mean: w_F = mean_F + H_FF^-1 (H_FG mean_G [+ nu 1]); what is free and far from any bound keeps
    the digits of the mean.
    """
    index, padded = free_indices(free)
    outside = torch.where(free, 0.0, mean)
    pull = grouped(precision, group, outside).gather(-1, index)
    block = precision[group[:, None, None], index[:, :, None], index[:, None, :]]
    scale = power_of_two(block.detach().diagonal(dim1=-2, dim2=-1).rsqrt())
    block = without_padding(block * scale[:, :, None] * scale[:, None, :], padded)
    pull = torch.where(padded, 0.0, pull * scale)
    inside = torch.where(padded, 0.0, mean.gather(-1, index))
    chol = cholesky(block, 0.0)
    if sum_to_one:
        ones = torch.where(padded, 0.0, scale)
        both = _refined(chol, block, torch.stack([pull, ones], dim=-1)) * scale[..., None]
        change, along = both.unbind(-1)
        nu = (1 - (inside + change).sum(-1, keepdim=True)) / along.sum(-1, keepdim=True)
        change = change + nu * along
    else:
        change = _refined(chol, block, pull[..., None])[..., 0] * scale
    kept = torch.where(padded, 0.0, inside + change)
    kept = torch.where(kept > 0, kept, 0.0 * kept)  # rounding may leave a variable at its bound below it
    return torch.zeros_like(mean).scatter_add(-1, index, kept)


def project_above(
    mean: Tensor,
    factor: Tensor,
    group: Tensor,
    rows: Tensor,
    bounds: Tensor,
    start: Tensor | None = None,
) -> tuple[Tensor, Tensor, Tensor]:
    """The w with rows w >= bounds nearest to the mean in the metric of L L^T.

    mean     (N, c)     float64
    factor   (S, c, c)  L, lower triangular
    group    (N,)       int64: program n has factor[group[n]]
    rows     (m, c) or (N, m, c)  A, shared by all or of each program
    bounds   (m,) or (N, m)       b; -inf where a row does not count
    start    (N, m)     multipliers to start from, at least 0 (those of an earlier call, 0 for new rows)
    returns  weights (N, c), with gradients to mean and factor; multipliers (N, m); iterations (N,) int64
    """
    if not rows.shape[-2]:
        return mean, mean.new_zeros(len(mean), 0), torch.zeros(len(mean), dtype=torch.int64, device=mean.device)
    shared = rows.ndim == 2
    with torch.no_grad():
        # where the rows are shared, so is M of each group
        own_factor = factor if shared else factor[group]
        spread = torch.linalg.solve_triangular(own_factor, rows.mT.expand(len(own_factor), -1, -1), upper=False)
        scale = power_of_two(torch.linalg.vector_norm(spread, dim=-2).reciprocal())
        spread = spread * scale[:, None]
        own = group if shared else torch.arange(len(mean), device=mean.device)
        metric = Metric(spread.mT @ spread, own, ridge=_RIDGE)
        scaled = scale[own]
        lack = (bounds - (rows @ mean[..., None])[..., 0]) * scaled
        lack = torch.where(torch.isfinite(lack), lack, -1.0)
        end = active_set(metric, lack, torch.zeros_like(lack) if start is None else start / scaled)
    index, padded = free_indices(end.free)
    kept = rows[index] if shared else rows.gather(1, index[..., None].expand(-1, -1, rows.shape[-1]))
    kept = torch.where(padded[..., None], 0.0, kept)
    short = bounds.expand_as(end.x).gather(1, index) - (kept @ mean[..., None])[..., 0]
    local = scaled.gather(1, index)
    whitened = torch.linalg.solve_triangular(factor[group], (kept * local[..., None]).mT, upper=False)
    block = without_padding(whitened.mT @ whitened, padded)
    lift = _refined(cholesky(block, _RIDGE), block, torch.where(padded, 0.0, short * local)[..., None])
    weights = mean + torch.linalg.solve_triangular(factor[group].mT, whitened @ lift, upper=True)[..., 0]
    lift = (lift[..., 0].detach() * local).clamp_min(0)
    multipliers = torch.zeros_like(end.x).scatter_add(-1, index, torch.where(padded, 0.0, lift))
    return weights, multipliers, end.iterations


def lift_above(gram: Tensor, short: Tensor) -> tuple[Tensor, Tensor]:
    """Multipliers of the rows A of `project_above`, where M = A H^-1 A^T is known and neither H nor its factor.

    gram     (N, m, m)  M
    short    (N, m)     b - A mean
    returns  l (N, m), so that w = mean + H^-1 A^T l, with gradients to both; iterations (N,) int64
    """
    with torch.no_grad():
        scale = power_of_two(gram.diagonal(dim1=-2, dim2=-1).rsqrt())
        unit = gram * scale[:, :, None] * scale[:, None, :]
        own = torch.arange(len(gram), device=gram.device)
        end = active_set(Metric(unit, own, ridge=_RIDGE), short * scale, torch.zeros_like(short))
    index, padded = free_indices(end.free)
    local = scale.gather(1, index)
    block = gram[own[:, None, None], index[:, :, None], index[:, None, :]] * local[:, :, None] * local[:, None, :]
    block = without_padding(block, padded)
    right = torch.where(padded, 0.0, short.gather(1, index) * local)
    lift = _refined(cholesky(block, _RIDGE), block, right[..., None])[..., 0] * local
    lift = torch.where(padded | (lift < 0), 0.0, lift)
    return torch.zeros_like(short).scatter_add(-1, index, lift), end.iterations


def _refined(chol: Tensor, block: Tensor, right: Tensor) -> Tensor:
    """block^-1 right, with one step of iterative refinement."""
    solved = torch.cholesky_solve(right, chol)
    return solved + torch.cholesky_solve(right - block @ solved, chol)


def kkt_residual(
    mean: Tensor,
    precision: Tensor,
    group: Tensor,
    weights: Tensor,
    multipliers: Tensor | None = None,
    rows: Tensor | None = None,
    bounds: Tensor | None = None,
    sum_to_one: bool = False,
) -> Tensor:
    """How far weights (N, c) are from the optimum: the largest of four residuals without unit, (N,).

    With s_i = sqrt(H_ii), size = the larger of |mean|_H and |w|_H (|w|_H^2 = w^T H w), y = H (w - mean) - nu 1 and
    nu = w^T H (w - mean), or 0 without the equality:
      stationarity     max_i |y - A^T l|_i / (s_i size)
      primal           max_j (b - A w)_j / (|A| |w| + |b|)_j, and |1^T w - 1|
      dual             max_j (-l_j) |A_j|_1/s / size, with |A_j|_1/s = max_i |A_ji| / s_i
      complementarity  max_j |l_j (A w - b)_j| / size^2
    For w >= 0 the multipliers are y itself, so stationarity holds by definition, and the primal residual is
    max_i (-w_i) s_i / size. All are 0 at the optimum in exact arithmetic, and 0 where mean and weights are 0.

    multipliers, rows, bounds  l (N, m), and A and b as in `project_above`; None for w >= 0
    """
    root = precision.diagonal(dim1=-2, dim2=-1).sqrt()[group]
    pull = grouped(precision, group, weights - mean)
    squares = [(v * grouped(precision, group, v)).sum(-1) for v in (mean, weights)]
    size = torch.maximum(*squares).clamp_min(0).sqrt()[:, None]
    size = torch.where(size > 0, size, 1.0)
    y, primal = pull, torch.zeros_like(weights[:, :1])
    if sum_to_one:
        y = pull - (weights * pull).sum(-1, keepdim=True)
        primal = (weights.sum(-1, keepdim=True) - 1).abs()
    if rows is None or bounds is None or multipliers is None:
        parts = [primal, -weights * root / size, -y / (root * size), (weights * y).abs() / size.square()]
    else:
        counts = torch.isfinite(bounds)
        limits = torch.where(counts, bounds, 0.0)
        slack = torch.where(counts, (rows @ weights[..., None])[..., 0] - limits, 0.0)
        terms = (rows.abs() @ weights.abs()[..., None])[..., 0] + limits.abs()
        each = zip(rows.expand(len(root), -1, -1), root, strict=True)
        length = torch.stack([(a.abs() / r).amax(-1) for a, r in each])
        parts = [
            primal,
            (y - (multipliers[:, None] @ rows)[:, 0]).abs() / (root * size),
            -slack / torch.where(terms > 0, terms, 1.0),
            -multipliers * length / size,
            (multipliers * slack).abs() / size.square(),
        ]
    return torch.cat(parts, dim=-1).amax(-1).clamp_min(0)
