"""Quadratic programs solved by SciPy, and how far rounding moves a solution."""

import numpy as np
import torch
from scipy.optimize import nnls
from torch import Tensor


def relative(found: Tensor, expected: Tensor) -> float:
    return float((found - expected).abs().max() / expected.abs().max())


def scipy_nonnegative(mean: Tensor, precision: Tensor) -> Tensor:
    upper = torch.linalg.cholesky(precision).mT
    return torch.from_numpy(nnls(upper.numpy(), (upper @ mean).numpy(), maxiter=100 * len(mean))[0])


def scipy_convex(mean: Tensor, precision: Tensor) -> Tensor:
    """min |U (w - mean)| over the simplex is the point of least norm in the hull of the columns of U - U mean 1^T,
    and that is a nonnegative least squares problem up to a factor."""
    upper = torch.linalg.cholesky(precision).mT
    hull = upper - (upper @ mean)[:, None]
    size = hull.abs().max()
    system = torch.cat([hull / size, torch.ones(1, len(mean), dtype=torch.float64)])
    v = torch.from_numpy(nnls(system.numpy(), np.eye(len(mean) + 1)[-1], maxiter=100 * len(mean))[0])
    return v / v.sum()


def scipy_above(mean: Tensor, precision: Tensor, rows: Tensor, bounds: Tensor) -> Tensor:
    """Least distance programming by nonnegative least squares [LH74, ch. 23]."""
    factor = torch.linalg.cholesky(precision)
    g = torch.linalg.solve_triangular(factor, rows.mT, upper=False)
    length = torch.linalg.vector_norm(g, dim=0)
    h = (bounds - rows @ mean) / length
    system = torch.cat([g / length, (h / h.abs().max())[None]])
    x = torch.from_numpy(nnls(system.numpy(), np.eye(len(mean) + 1)[-1], maxiter=100 * len(rows))[0])
    r = system @ x - torch.eye(len(mean) + 1, dtype=torch.float64)[-1]
    u = -r[:-1] / r[-1] * h.abs().max()
    return mean + torch.linalg.solve_triangular(factor.mT, u[:, None], upper=True)[:, 0]


def another_order(mean: Tensor, precision: Tensor, weights: Tensor) -> float:
    """The norm by which nonnegative weights (c,) may move where sums over the c columns are taken in another order.

    They solve H_FF (w - mean)_F = H_FG mean_G, whose sums are off by sqrt(c) eps times those of the sizes: errors add
    up like a random walk. The smallest eigenvalue of H_FF divides that. And w is a sum, too.
    """
    free = weights > 0
    terms = precision[free].abs() @ (weights - mean).abs()
    smallest = torch.linalg.eigvalsh(precision[free][:, free])[0]
    return float(len(mean) ** 0.5 * torch.finfo(mean.dtype).eps * (terms.norm() / smallest + weights.norm()))
