"""Bounded quadratic programs, many at once: min 1/2 x^T M x - d^T x over x >= 0, at wish with total^T x = 1.

The active set method of [LH74, ch. 23], changed in two ways: several variables enter at once, and a step that leaves
the feasible set is first tried clipped, so that several variables leave at once, and is shortened to the first bound it
meets only where the clipped step does not lower the objective. The objective falls with every change of the free set,
so no free set comes twice and the method ends, at the exact vertex. Programs run side by side and stop one by one.

No tolerance carries a unit: variables are scaled to M_ii in [1/2, 2] by powers of two, which round nothing, and
rounding is compared with the sizes of the terms that made it. Nothing here carries a gradient.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

EPS = torch.finfo(torch.float64).eps
_FEW = 4
"""Variables that enter at once after others had to leave; twice as many each time none had to."""


@dataclass(frozen=True)
class ActiveSet:
    """Where the active set method ended, for N programs of k variables.

    x           (N, k)  at least 0
    free        (N, k)  bool, the variables that are not held at 0
    iterations  (N,)    int64, linear solves taken
    """

    x: Tensor
    free: Tensor
    iterations: Tensor


@dataclass(frozen=True)
class Metric:
    """M of S groups of programs, with unit diagonal to a factor of two; program n belongs to group[n].

    matrix  (S, k, k)
    group   (N,) int64
    total   (S, k) or None: positive coefficients of the equality total^T x = 1
    ridge   added to the diagonal where M may be singular
    """

    matrix: Tensor
    group: Tensor
    total: Tensor | None = None
    ridge: float = 0.0

    def select(self, which: Tensor) -> "Metric":
        """Of some of the programs."""
        return Metric(self.matrix, self.group[which], self.total, self.ridge)

    def block(self, index: Tensor) -> Tensor:
        """(N, q, q): the rows and columns index (N, q) of M."""
        return self.matrix[self.group[:, None, None], index[:, :, None], index[:, None, :]]

    def times(self, x: Tensor) -> Tensor:
        """M x (N, k) without the ridge."""
        return grouped(self.matrix, self.group, x)


def active_set(metric: Metric, d: Tensor, start: Tensor) -> ActiveSet:
    """Minimise 1/2 x^T M x - d^T x over x >= 0 [and total^T x = 1], from a feasible start.

    d, start  (N, k)
    returns   see ActiveSet; a program that does not end within 10 k + 100 solves is returned as it stands
    """
    n, k = d.shape
    x, free = start.clone(), start > 0
    iterations = torch.zeros(n, dtype=torch.int64, device=d.device)
    entering = torch.full((n,), _FEW, device=d.device)  # at most so many variables enter at once
    value = 0.5 * (x * metric.times(x)).sum(-1) - (d * x).sum(-1)
    settled = torch.full_like(value, torch.inf)  # the objective when the free set last grew
    running = torch.arange(n, device=d.device)
    for _ in range(10 * k + 100):
        if not len(running):
            break
        part = metric.select(running)
        here, now, target = x[running], free[running], d[running]
        iterations[running] += 1
        best, nu = _minimise_free(part, target, now)
        left = now & (best <= 0)
        cut = left.any(-1)
        trial = torch.where(left, 0.0, best)
        if part.total is not None:
            sums = (part.total[part.group] * trial).sum(-1, keepdim=True)
            trial = torch.where(sums > 0, trial / torch.where(sums > 0, sums, 1.0), here)
        product = part.times(trial)
        trial_value = 0.5 * (trial * product).sum(-1) - (target * trial).sum(-1)
        back = cut & ~(trial_value < value[running])
        # the shortened step
        ratio = torch.where(left, here / torch.where(left, here - best, 1.0), 1.0).clamp(0, 1)
        ratio = torch.where(left & (here <= 0), 0.0, ratio)
        step = ratio.amin(-1, keepdim=True)
        shortened = torch.where(left & (ratio <= step), 0.0, here + step * (best - here)).clamp_min(0)
        new = torch.where(back[:, None], shortened, trial)
        kept = torch.where(back[:, None], now & ~(left & (ratio <= step)), now & ~left)
        if back.any():
            again = part.select(torch.nonzero(back).ravel()).times(shortened[back])
            product[back] = again
            trial_value[back] = 0.5 * (shortened[back] * again).sum(-1) - (target[back] * shortened[back]).sum(-1)
        x[running], value[running] = new, trial_value
        # where the free set's minimum is inside, variables that lower the objective enter
        down = target - product
        size = target.abs() + product.abs()
        if part.total is not None:
            down = down + nu[:, None] * part.total[part.group]
        threshold = 4 * k * EPS * size
        gain = torch.where(kept | (down <= threshold), 0.0, down)
        whole = ~cut
        stuck = whole & (trial_value >= settled[running])
        limit = torch.where(stuck, 1, entering[running])
        over = stuck & (entering[running] == 1)
        entering[running] = torch.where(cut, _FEW, 2 * limit)
        settled[running] = torch.where(whole, torch.minimum(trial_value, settled[running]), settled[running])
        done = whole & ((gain.amax(-1) <= 0) | over)
        chosen = _largest(gain, limit) & (whole & ~done)[:, None]
        free[running] = kept | chosen
        running = running[~done]
    return ActiveSet(x, free, iterations)


def _largest(gain: Tensor, limit: Tensor) -> Tensor:
    """(N, k) bool: the positive entries among the limit (N,) largest of each row."""
    most = int(limit.max())
    if most >= gain.shape[-1]:
        return gain > 0
    values, index = gain.topk(most, dim=-1)
    wanted = (values > 0) & (torch.arange(most, device=gain.device) < limit[:, None])
    return torch.zeros_like(gain, dtype=torch.bool).scatter(-1, index, wanted)


def _minimise_free(metric: Metric, d: Tensor, free: Tensor) -> tuple[Tensor, Tensor]:
    """The minimum (N, k) over the free variables alone, the others 0, and the multiplier (N,) of the equality."""
    index, padded = free_indices(free)
    block = without_padding(metric.block(index), padded)
    right = torch.where(padded, 0.0, d.gather(-1, index))
    chol = cholesky(block, metric.ridge)
    nu = d.new_zeros(len(d))
    if metric.total is None:
        solved = torch.cholesky_solve(right[..., None], chol)[..., 0]
    else:
        total = torch.where(padded, 0.0, metric.total[metric.group].gather(-1, index))
        both = torch.cholesky_solve(torch.stack([right, total], dim=-1), chol)
        first, along = both.unbind(-1)
        nu = (1 - (total * first).sum(-1)) / (total * along).sum(-1)
        solved = first + nu[:, None] * along
    solved = torch.where(padded, 0.0, solved)
    return torch.zeros_like(d).scatter_add(-1, index, solved), nu


def free_indices(free: Tensor) -> tuple[Tensor, Tensor]:
    """The free variables (N, q) of each program first, q the most of any (at least 1), and which are padding."""
    q = max(int(free.sum(-1).max()), 1)
    index = torch.argsort(free.to(torch.int8), dim=-1, descending=True, stable=True)[:, :q]
    return index, ~free.gather(-1, index)


def without_padding(block: Tensor, padded: Tensor) -> Tensor:
    """Rows and columns of padding become those of the identity."""
    touched = padded[:, :, None] | padded[:, None, :]
    return torch.where(touched, torch.eye(block.shape[-1], dtype=block.dtype, device=block.device), block)


def cholesky(block: Tensor, ridge: float) -> Tensor:
    """The factor of blocks (N, q, q) with unit diagonal; one that is singular in rounding gets a larger ridge."""
    eye = torch.eye(block.shape[-1], dtype=block.dtype, device=block.device)
    chol, info = torch.linalg.cholesky_ex(block + ridge * eye)
    for larger in (1e-12, 1e-10, 1e-8):
        if not info.any():
            break
        chol, info = torch.linalg.cholesky_ex(block + torch.where(info > 0, larger, ridge)[:, None, None] * eye)
    return chol


def power_of_two(scale: Tensor) -> Tensor:
    """The power of two nearest to each scale: multiplying by it rounds nothing. 1 where it is not finite."""
    sound = torch.isfinite(scale) & (scale > 0)
    return torch.exp2(torch.round(torch.log2(torch.where(sound, scale, 1.0))))


def grouped(matrix: Tensor, group: Tensor, x: Tensor) -> Tensor:
    """x_n^T matrix_group(n), (N, columns), without a copy of a matrix for each n where groups are shared."""
    if matrix.shape[0] > max(3, len(group) // 2):
        return (x[:, None] @ matrix[group])[:, 0]
    order = torch.argsort(group, stable=True)
    counts = torch.bincount(group, minlength=matrix.shape[0]).tolist()
    parts = [part @ matrix[g] for g, part in enumerate(x[order].split(counts)) if counts[g]]
    return torch.cat(parts)[torch.argsort(order)]
