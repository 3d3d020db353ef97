"""Constrained weights: the point of a feasible set that is nearest to the posterior mean in the posterior's metric.

The penalised least squares of one class [CBP21, eq. 26] with a constraint has the solution

    minimise 1/2 (w - mean)^T H (w - mean)  over the feasible set,    H = Y^T W Y + lambda S^-1,

with the mean of the unconstrained solve: the photograph enters only there. The sets are

    "nonnegative"  w >= 0
    "convex"       w >= 0 and sum w = 1: a weighted average of the library's columns
    "energy"       B w >= 0 in every measured cell above the horizon, and directional albedo <= 1 at every view angle
    "lobes"        B w >= 0 and falling within 4 degrees of the middle of highlights, see `lobe_bounds`

The first and the last have no scale: a mean twice as large gives weights twice as large. The convex set and the bound
of the albedo are physical: they hold in the units of the library, so the exposure of the photograph and of the probe
must agree.
"""

import warnings
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from torchbrdf.brdf import GRID, ROW_CELLS, MaterialLibrary
from torchbrdf.estimation.energy_bounds import EnergyBounds, depth_below_zero
from torchbrdf.estimation.lobe_bounds import LobeBounds
from torchbrdf.estimation.settings import CONSTRAINTS, Constraint
from torchbrdf.estimation.solvers import kkt_residual, project_above, project_nonnegative

TOLERANCE = 1e-6
"""A cell may lie below zero by this times B |w| there; also the optimality residual above which `constrain` warns."""

_SURE = 0.9 * TOLERANCE
"""Below this no further look at the cells is needed; the rest of the tolerance is the rounding of float32."""

_ENTER = 24
"""Cells that one photograph and channel may add to the working rows at once: the worst of as many bins."""

_BIN = (6, 6)
"""Cells of such a bin in theta_h and theta_d, all phi_d."""

_NOTHING = 1e-9
"""Weights this small beside the mean, in the metric's norm, are the rounding of an optimum at 0, which is feasible; as
they stand their sign is noise."""

_TOGETHER = 32
"""Programs solved side by side: enough to share the calls, few enough to stay in the cache."""

_SCANS, _SETTLES = 60, 400
"""Looks at all cells, and at the pool between two of them, before `constrain` gives up and says so."""


Bounds = EnergyBounds | LobeBounds
_BOUNDS: dict[str, type[Bounds]] = {"energy": EnergyBounds, "lobes": LobeBounds}


def bounds_of(constraint: Constraint | None, library: MaterialLibrary | None) -> Bounds | None:
    """What a constraint needs of a library: nothing, or its bounds. Raises ValueError where there is no library."""
    if constraint not in _BOUNDS:
        return None
    if library is None:
        raise ValueError(f'constraint "{constraint}" needs the library of the basis images: library=...')
    return _BOUNDS[constraint].of(library)


@dataclass(frozen=True)
class Constrained:
    """The constrained weights of photographs.

    weights     (*batch, 3, c)  float64, with gradients to the mean and the precision
    optimality  (*batch, 3)     residual without unit, see `quadratic_programs.kkt_residual`; for "energy" at least
                                the largest -(B w) / (B |w|) of any cell; in the posterior's own metric the one that
                                `posterior_projection` says
    iterations  (*batch, 3)     int64: linear solves of the active set method; 0 where the mean was feasible
    """

    weights: Tensor
    optimality: Tensor
    iterations: Tensor


def constrain(
    mean: Tensor, precision: Tensor, constraint: Constraint, bounds: Bounds | None = None
) -> Constrained:
    """The feasible weights nearest to the posterior mean in the metric of the posterior precision.

    mean        (*batch, 3, c)                         posterior mean of each colour channel
    precision   (3, c, c) or (*batch, 3, c, c)         its precision H, symmetric positive definite
    constraint  "nonnegative", "convex", "energy" or "lobes"    see the top of this module
    bounds      the library's, see `bounds_of`; for c of its columns use their `select`
    returns     see Constrained. A mean that is feasible comes back as it is.

    Works in float64. Weights have gradients to mean and precision: those of the linear solve on the final active set.
    Warns where the optimality residual is above TOLERANCE. Raises ValueError for shapes that do not fit, values that
    are not finite, or an unknown constraint.
    """
    _check(mean, precision, constraint, bounds)
    shape, c = mean.shape, mean.shape[-1]
    points = mean.double().reshape(-1, c)
    precision = precision.double()
    if precision.ndim == 3:
        group = torch.arange(len(points), device=mean.device) % 3
    else:
        precision = precision.expand(*shape[:-1], c, c).reshape(-1, c, c)
        group = torch.arange(len(points), device=mean.device)
    if isinstance(bounds, EnergyBounds) and constraint == "energy":
        weights, optimality, iterations = _within_energy(points, precision, group, bounds)
    elif isinstance(bounds, LobeBounds) and constraint == "lobes":
        weights, optimality, iterations = _above(bounds.rows.to(points.device), points, precision, group)
    else:
        convex = constraint == "convex"
        weights, iterations = project_nonnegative(points, precision, group, convex)
        with torch.no_grad():
            optimality = kkt_residual(points, precision, group, weights, sum_to_one=convex)
    warn_of(constraint, optimality)
    return Constrained(weights.reshape(shape), optimality.reshape(shape[:-1]), iterations.reshape(shape[:-1]))


def _check(mean: Tensor, precision: Tensor, constraint: str, bounds: Bounds | None) -> None:
    if constraint not in CONSTRAINTS:
        raise ValueError(f"constraint must be one of {', '.join(CONSTRAINTS)}, got {constraint!r}")
    if mean.ndim < 2 or mean.shape[-2] != 3 or mean.shape[-1] < 1:
        raise ValueError(f"mean must be (*batch, 3, c), got {tuple(mean.shape)}")
    c = mean.shape[-1]
    if tuple(precision.shape) not in ((3, c, c), (*mean.shape, c)):
        raise ValueError(
            f"precision must be (3, {c}, {c}) or {(*mean.shape, c)} for this mean, got {tuple(precision.shape)}"
        )
    if not (torch.isfinite(mean).all() and torch.isfinite(precision).all()):
        raise ValueError("mean and precision must be finite; check the photograph and the basis images for NaN")
    if not (precision.diagonal(dim1=-2, dim2=-1) > 0).all():
        raise ValueError("precision must be positive definite, its diagonal is not; the penalty must be above 0")
    wanted = _BOUNDS.get(constraint)
    if wanted is not None:
        if not isinstance(bounds, wanted):
            raise ValueError(f'constraint "{constraint}" needs bounds; pass {wanted.__name__}.of(library)')
        columns = len(bounds.columns) if isinstance(bounds, EnergyBounds) else bounds.rows.shape[1]
        if columns != c:
            raise ValueError(f"bounds are for {columns} weights, mean has {c}; use bounds.select(members)")


def warn_of(constraint: str, optimality: Tensor) -> None:
    """Warn where the optimality residual of any photograph and channel is above TOLERANCE."""
    poor = ~(optimality <= TOLERANCE)
    if poor.any():
        warnings.warn(
            f"constraint {constraint!r} is not met exactly in {int(poor.sum())} of {optimality.numel()} photographs "
            f"and channels: optimality residual up to {float(optimality.max()):.1e}, expected at most {TOLERANCE:.0e}",
            RuntimeWarning,
            stacklevel=3,
        )


def _within_energy(
    mean: Tensor, precision: Tensor, group: Tensor, bounds: EnergyBounds
) -> tuple[Tensor, Tensor, Tensor]:
    """Generation of constraints: solve with few cells, add the most negative ones, repeat."""
    factor = _factor(precision)
    with torch.no_grad():
        work = _WorkingRows(bounds, mean, precision, factor, group)
        depth = work.generate()
    rows, limits, multipliers = work.padded(torch.arange(len(mean), device=mean.device))
    weights, used = mean, torch.nonzero(work.iterations > 0).ravel()
    if len(used):
        solved, found, _ = project_above(
            mean[used], factor, group[used], rows[used], limits[used], start=multipliers[used]
        )
        solved = solved * _above_rounding(solved, mean[used], precision[group[used]])
        weights = solved if len(used) == len(mean) else mean.index_copy(0, used, solved)
        multipliers[used] = found
    with torch.no_grad():
        residual = kkt_residual(mean, precision, group, weights, multipliers, rows, limits)
    return weights, torch.maximum(residual, depth), work.iterations


def _above(rows: Tensor, mean: Tensor, precision: Tensor, group: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Few rows A w >= 0, all of them at once; those of 0, as of matte columns, say nothing."""
    rows = rows[(rows != 0).any(-1)]
    limits = rows.new_zeros(len(rows))
    weights, multipliers, iterations = project_above(mean, _factor(precision), group, rows, limits)
    weights = feasible_at_zero(weights, mean)
    with torch.no_grad():
        residual = kkt_residual(mean, precision, group, weights, multipliers, rows, limits)
    return weights, residual, iterations


def feasible_at_zero(weights: Tensor, mean: Tensor) -> Tensor:
    """Weights without those that are nothing beside the mean's: a row may be of one column, and be met at 0."""
    return weights * (weights.abs() > _NOTHING * mean.abs())


def _factor(precision: Tensor) -> Tensor:
    factor, info = torch.linalg.cholesky_ex(precision)
    if info.any():
        raise ValueError("precision must be positive definite for rows of bounds; the penalty must be larger")
    return factor


def _above_rounding(weights: Tensor, mean: Tensor, precision: Tensor) -> Tensor:
    """(N, 1) bool: programs whose weights are more than rounding; precision (N, c, c)."""
    with torch.no_grad():
        sizes = [(v[:, None] @ precision @ v[..., None])[:, 0].clamp_min(0).sqrt() for v in (weights, mean)]
    return sizes[0] > _NOTHING * sizes[1]


class _WorkingRows:
    """The rows A w >= b that matter to each program: all of the albedo's, and cells found to lie below zero.

    Cells come from a pool, at first the thinned ones. Where no cell of the pool is below zero, all cells are looked
    at, and the worst join the pool, which never shrinks: the objective rises with every look at all, so this ends.
    """

    def __init__(
        self, bounds: EnergyBounds, mean: Tensor, precision: Tensor, factor: Tensor, group: Tensor
    ) -> None:
        self.bounds, self.mean, self.group = bounds, mean, group
        self.precision, self.factor = precision, factor
        self.albedo = -bounds.albedo.to(mean.device)
        self.pool_cells, self.pool_rows = bounds.cells.to(mean.device), bounds.thinned.to(mean.device)
        self.weights = mean.clone()
        self.iterations = torch.zeros(len(mean), dtype=torch.int64, device=mean.device)
        none = torch.empty(0, dtype=torch.int64, device=mean.device)
        self.chosen = [none] * len(mean)  # where in the pool
        self.multipliers = [mean.new_zeros(len(self.albedo))] * len(mean)

    def generate(self) -> Tensor:
        """Add rows until no cell is below zero; returns the largest -(B w) / (B |w|) of each program (N,)."""
        depth = torch.zeros_like(self.mean[:, 0])
        self._solve(torch.nonzero((self.weights @ self.albedo.mT < -1).any(-1)).ravel())
        running = torch.nonzero((self.weights < 0).any(-1)).ravel()  # B >= 0: the others are nowhere below zero
        for _ in range(_SCANS):
            if not len(running):
                break
            self._settle(running)
            deepest, cells = self.bounds.scan(self.weights[running].to(self.bounds.columns.device), TOLERANCE / 2)
            depth[running] = deepest.clamp_min(0).to(depth)
            running = running[depth[running] > _SURE]
            cells = cells[~torch.isin(cells, self.pool_cells.to(cells.device))]
            if not len(cells):
                break
            self.pool_cells = torch.cat([self.pool_cells, cells.to(self.pool_cells.device)])
            self.pool_rows = torch.cat([self.pool_rows, self.bounds.rows(cells).to(self.pool_rows)])
        return depth

    def padded(self, which: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Rows (N, m, c), limits (N, m) and multipliers (N, m) of some programs; -inf and 0 where one has fewer."""
        numbers = which.tolist()
        rows = pad_sequence(
            [torch.cat([self.albedo, self.pool_rows[self.chosen[n]].double()]) for n in numbers], batch_first=True
        )
        limits = self.mean.new_full(rows.shape[:-1], -torch.inf)
        for n, limit in zip(numbers, limits, strict=True):
            limit[: len(self.albedo)] = -1.0
            limit[len(self.albedo) :][: len(self.chosen[n])] = 0.0
        return rows, limits, pad_sequence([self.multipliers[n] for n in numbers], batch_first=True)

    def _settle(self, running: Tensor) -> None:
        """Solve until no cell of the pool lies below zero."""
        h, d = self.pool_cells // ROW_CELLS // _BIN[0], self.pool_cells % ROW_CELLS // (GRID[2] * _BIN[1])
        bins = h * (GRID[1] // _BIN[1]) + d
        n_bins = GRID[0] // _BIN[0] * (GRID[1] // _BIN[1])
        places = torch.arange(len(bins), device=bins.device)[:, None]
        for _ in range(_SETTLES):
            if not len(running):
                break
            w = self.weights[running]
            depth = depth_below_zero(self.pool_rows @ torch.cat([w, w.abs()]).float().mT, len(running))
            for column, n in enumerate(running.tolist()):  # these hold but for rounding
                depth[self.chosen[n], column] = 0.0
            spread = bins[:, None].expand_as(depth)
            best = depth.new_zeros(n_bins, len(running)).scatter_reduce(0, spread, depth, "amax")
            here = torch.where(depth == best[bins], places, len(bins))
            first = here.new_full(best.shape, len(bins)).scatter_reduce(0, spread, here, "amin")
            value, order = best.topk(_ENTER, dim=0)
            found, new = value > TOLERANCE / 2, first.gather(0, order)
            for column, n in enumerate(running.tolist()):
                entering = new[found[:, column], column]
                self.chosen[n] = torch.cat([self.chosen[n], entering])
                self.multipliers[n] = torch.cat([self.multipliers[n], self.mean.new_zeros(len(entering))])
            running = running[found.any(0)]
            self._solve(running)

    def _solve(self, which: Tensor) -> None:
        for part in which.split(_TOGETHER) if len(which) else ():
            rows, limits, start = self.padded(part)
            mean, group = self.mean[part], self.group[part]
            solved, found, iterations = project_above(mean, self.factor, group, rows, limits, start=start)
            self.weights[part] = solved * _above_rounding(solved, mean, self.precision[group])
            self.iterations[part] += iterations
            for n, multipliers in zip(part.tolist(), found, strict=True):
                albedo, cells = multipliers[: len(self.albedo)], multipliers[len(self.albedo) :][: len(self.chosen[n])]
                self.chosen[n] = self.chosen[n][cells > 0]
                self.multipliers[n] = torch.cat([albedo, cells[cells > 0]])
