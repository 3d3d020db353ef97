"""The average over priors moved within rows A w >= 0, in the metric of the posterior itself.

    minimise 1/2 (w - mean)^T C^-1 (w - mean)   subject to   A w >= 0

with C the covariance of the mixture is w = mean + C A^T l, where l >= 0 minimises 1/2 l^T M l + l^T A mean with
M = A C A^T. Few rows show little of every prior, which is made once; so C itself, which takes ten times as long as to
explain a photograph, is never formed.

Shapes: as in `priors.bank`, and m rows.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from torchbrdf.estimation.constraints import Constrained, feasible_at_zero, warn_of
from torchbrdf.estimation.lobe_bounds import LobeBounds
from torchbrdf.estimation.priors import Explanation, PriorBank
from torchbrdf.estimation.solvers import lift_above
from torchbrdf.lasting import lasting

_ROUNDING = 1e-12
"""Share of the priors' own variance that a posterior has at least, for its rounding not to count."""


@dataclass(frozen=True, eq=False)
class SeenPriors:
    """What rows A (m, n), few of them, show of the priors of a bank."""

    bank: PriorBank
    rows: Tensor

    @classmethod
    def of(cls, bank: PriorBank, bounds: LobeBounds) -> "SeenPriors":
        """Those of highlights; rows of 0, as of matte columns, say nothing."""
        rows = bounds.rows.to(bank.variances.device)
        return cls(bank, rows[(rows != 0).any(-1)])

    @cached_property
    @lasting
    def directions(self) -> Tensor:
        """(3, M, r, m): V^T R S A^T."""
        varied = self.bank.variances[:, :, None] * self.rows.mT
        return self.bank.vectors.transpose(0, 1).mT @ (self.bank.space.white[:, None] @ varied)

    @cached_property
    @lasting
    def variances(self) -> Tensor:
        """(M, m, m): A S A^T."""
        return (self.rows * self.bank.variances[:, None]) @ self.rows.mT

    @cached_property
    @lasting
    def means(self) -> Tensor:
        """(M, m): A mu."""
        return self.bank.means @ self.rows.mT

    @cached_property
    @lasting
    def inverse(self) -> Tensor:
        """(3, M, L, r): 1 / (eigenvalue + lambda)."""
        return (self.bank.damping / self.bank.penalties[..., None]).transpose(0, 1)

    def project(self, found: Explanation, mean: Tensor) -> Constrained:
        """The nearest weights to the posterior mean (B, 3, n) of photographs, with gradients to the photographs.

        A mean that is feasible comes back as it is. Warns where the optimality residual is above the tolerance: how far
        A w lies below 0, or from 0 where a multiplier holds it there, as a share of |A| times the larger of |w| and
        |mean|.
        """
        shown = mean @ self.rows.mT
        outside = torch.nonzero((shown < 0).any(-1).any(-1)).ravel()
        residual, iterations = shown.new_zeros(shown.shape[:2]), shown.new_zeros(shown.shape[:2], dtype=torch.int64)
        nearest = mean
        if len(outside):
            each = [_SeenPosterior(self, found, row, shown[row]) for row in outside.tolist()]
            lifted, used = lift_above(torch.cat([one.covariance for one in each]), -shown[outside].flatten(0, 1))
            lifts = lifted.unflatten(0, (-1, 3))
            changes = [one.change(lift, mean[one.row]) for one, lift in zip(each, lifts, strict=True)]
            moved = feasible_at_zero(mean[outside] + torch.stack(changes), mean[outside])
            nearest = mean.index_copy(0, outside, moved)
            with torch.no_grad():
                residual[outside] = self._residual(moved, mean[outside], lifts)
            iterations[outside] = used.view(-1, 3)
            warn_of("lobes", residual)
        return Constrained(nearest, residual, iterations)

    def _residual(self, weights: Tensor, mean: Tensor, multipliers: Tensor) -> Tensor:
        shown, size = weights @ self.rows.mT, torch.maximum(weights.abs(), mean.abs()) @ self.rows.abs().mT
        off = torch.where(multipliers > 0, shown.abs(), -shown)
        return (off / torch.where(size > 0, size, 1)).amax(-1).clamp_min(0)


class _SeenPosterior:
    """C of one photograph, the `row` of a batch, as far as rows show it; prior m and penalty l as in `Moments.of`.

    within  (3, M)  v, times the share of the pair, summed over the penalties
    spread  (3, M, r)  sum of v / s over the penalties
    off     (3, M, L, m)  how far A shows the pair's mean from that of all, which it shows as (3, m)
    """

    def __init__(self, seen: SeenPriors, found: Explanation, row: int, shown: Tensor) -> None:
        bank = seen.bank
        self.seen, self.row, self.share = seen, row, found.shares[row]
        self.brightness, self.deviation = found.brightness[row].mT, found.deviation[row].transpose(0, 1)
        v = found.quadratic[row] / (bank.independent_pixels * bank.penalties)
        varied = (self.share[:, None] * v).transpose(0, 1)
        self.within = (1 + _ROUNDING) * varied.sum(-1)
        self.spread = (varied[..., None, :] @ seen.inverse)[..., 0, :]
        deviations = (seen.inverse * self.deviation[..., None, :]) @ seen.directions
        levels = self.brightness[..., None] * seen.means
        self.off = deviations + (levels - shown[:, None])[..., None, :]

    @property
    def covariance(self) -> Tensor:
        """(3, m, m): A C A^T."""
        seen = self.seen
        prior = torch.tensordot(self.within, seen.variances, 1)
        directions, off = seen.directions.flatten(1, 2), self.off.flatten(1, 2)
        known = (directions * self.spread.flatten(1)[..., None]).mT @ directions
        return prior - known + (off * self.share.flatten()[:, None]).mT @ off

    def change(self, multipliers: Tensor, mean: Tensor) -> Tensor:
        """(3, n): C A^T l, of multipliers (3, m) and the mean (3, n) of all pairs."""
        seen, bank = self.seen, self.seen.bank
        pull = multipliers @ seen.rows
        drawn = self.share * (self.off @ multipliers[:, None, :, None])[..., 0]  # (3, M, L), towards means of pairs
        towards = (drawn[..., None, :] @ seen.inverse)[..., 0, :] * self.deviation
        towards = towards - self.spread * (seen.directions @ multipliers[:, None, :, None])[..., 0]
        turned = (bank.vectors @ towards.transpose(0, 1)[..., None])[..., 0].transpose(0, 1) @ bank.space.white
        varied = (bank.variances * (turned + self.within[..., None] * pull[:, None])).sum(1)
        return varied + (drawn.sum(-1) * self.brightness) @ bank.means - drawn.sum((1, 2))[:, None] * mean
