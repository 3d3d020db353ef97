"""What the photograph leaves open: the posterior of the weights, a mixture of Gaussians, made wide enough to be true.

The mixture alone knows no material outside the span of the library and is too sure of itself. One constant mends that:
beside it a share UNMODELLED of what is predicted is unknown. How it was chosen, and how often intervals then hold what
they should: docs/uncertainty.md.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from torchbrdf.estimation.priors import Explanation
from torchbrdf.lasting import without_autocast

UNMODELLED = 0.01
"""What is predicted is wrong by this share: basis images, the grid of cells, photographs."""

TAIL = 1e-2
"""Share of the variance that `brdf_std` leaves out to be faster: below 1 % of the median cell's standard deviation."""

_LEAST = 1e-3
"""Priors of less probability than this do not enter variances."""

_ROUNDING = 1e-14
"""Directions with less than this share of the largest variance are rounding of the covariance."""


@dataclass(frozen=True, eq=False, repr=False)
class Moments:
    """Mean (3, n) and covariance (3, n, n) of the weights of each colour channel, float64."""

    mean: Tensor
    covariance: Tensor

    def __repr__(self) -> str:
        """The shapes."""
        return f"Moments(mean {tuple(self.mean.shape)}, covariance {tuple(self.covariance.shape)})"

    @classmethod
    def of(cls, found: Explanation, probabilities: Tensor, row: int) -> "Moments":
        """Of the mixture of one photograph, the `row` of a batch; probabilities (M, L).

        Prior m and penalty l say w ~ N(a mu + D (V^T y) / s, v (S - D diag(1/s) D^T)) with D = S R^T V, eigenvalues e,
        s = e + lambda, v = |residual|^2 / (independent pixels lambda). The penalties of a prior share D, so each prior
        costs one product.
        """
        bank = found.bank
        weight = probabilities.sum(-1)
        likely = torch.nonzero(weight > (weight.amax() / 2).clamp_max(_LEAST)).ravel().tolist()
        n = bank.variances.shape[1]
        covariance, diagonal = bank.variances.new_zeros(3, n, n), bank.variances.new_zeros(3, n)
        means, shares = [], []
        for m in likely:
            share = probabilities[m] / weight[likely].sum()
            spectrum = bank.values[m][:, None] + bank.penalties[m, ..., None]
            scale = share / bank.independent_pixels * found.quadratic[row, m] / bank.penalties[m]
            directions = bank.variances[m][:, None] * (bank.space.white.mT @ bank.vectors[m])
            diagonal += scale.sum(1, keepdim=True) * bank.variances[m]
            covariance -= (directions * (scale[..., None] / spectrum).sum(1)[:, None]) @ directions.mT
            deviation = directions @ (found.deviation[row, m][:, None] / spectrum).mT
            means.append((found.brightness[row, m][:, None] * bank.means[m])[..., None] + deviation)
            shares.append(share)
        share, each = torch.cat(shares), torch.cat(means, -1)
        mean = each @ share
        spread = (each - mean[..., None]) * share.sqrt()
        return cls(mean, covariance + torch.diag_embed(diagonal) + spread @ spread.mT)


@dataclass(frozen=True, eq=False, repr=False)
class Posterior:
    """The posterior of the weights of one photograph.

    explanation    of a batch of photographs that holds it, without gradients
    probabilities  (M, L) of prior and penalty
    row            its place in the batch
    """

    explanation: Explanation
    probabilities: Tensor
    row: int

    def __repr__(self) -> str:
        """How many priors and penalties it averages."""
        priors, penalties = self.probabilities.shape
        return f"Posterior({priors} priors, {penalties} penalties each)"

    @cached_property
    def moments(self) -> Moments:
        """Mean and covariance of the mixture as it is, without UNMODELLED."""
        return Moments.of(self.explanation, self.probabilities, self.row)

    @cached_property
    def factor(self) -> Tensor:
        """F (3, n, n + 1) float64: the variance of rows w is |rows F|^2, never below zero.

        A root of the covariance, and UNMODELLED times the mean.
        """
        values, vectors = torch.linalg.eigh(self.moments.covariance)
        values = torch.where(values > _ROUNDING * values[:, -1:], values, 0)
        root = vectors * values.sqrt()[:, None]
        return torch.cat([root, UNMODELLED * self.moments.mean[..., None]], -1)

    def compressed(self, rows: Tensor) -> Tensor:
        """A factor (3, n, k) for many more rows like these (N, n) than it pays to show the whole factor, with k < n.

        In coordinates in which such rows, each divided by its standard deviation, are uncorrelated and of one size, the
        directions of least variance are left out: on average over the rows they make up the share TAIL of each's own.
        """
        std = self.std(rows)[..., None]
        unit = (rows / torch.where(std > 0, std, 1)).to(self.factor)
        squared, v = torch.linalg.eigh(unit.mT @ unit)
        root = squared.clamp_min(0).sqrt()
        inverse = torch.where(squared > _ROUNDING * squared[:, -1:], 1 / root, 0)
        shown = (v * root[:, None]).mT @ self.factor
        values, vectors = torch.linalg.eigh(shown @ shown.mT)
        values = values.clamp_min(0)
        kept = (values.cumsum(-1) > TAIL * values.sum(-1, keepdim=True)).any(0)
        return (v * inverse[:, None]) @ (vectors * values.sqrt()[:, None])[..., kept]

    @without_autocast
    def std(self, rows: Tensor, factor: Tensor | None = None) -> Tensor:
        """Standard deviations of linear functions of the weights, such as pixels and cells of the BRDF.

        rows     (N, n) or (3, N, n)  one function a row, the same or its own for each colour channel; the product is
                 made in their precision, and float32 is enough for it: 1e-3 of a standard deviation
        factor   of `compressed`; None: all of `factor`
        returns  (3, N)  of each channel
        """
        return torch.linalg.vector_norm(rows @ (self.factor if factor is None else factor).to(rows), dim=-1)


@dataclass(frozen=True, eq=False, repr=False)
class PosteriorBatch:
    """The posteriors of a batch of photographs.

    groups  explanations of photographs that share a mask; none where they were left out to save memory
    where   (*batch, 2)  int64: group and row of each photograph
    """

    groups: tuple[Explanation, ...]
    where: Tensor

    def __repr__(self) -> str:
        """How many there are."""
        count = " x ".join(map(str, self.where.shape[:-1]))
        what = f"{count} photographs" if count else "1 photograph"
        return f"PosteriorBatch({what}{'' if self.groups else ', left out'})"

    def __getitem__(self, i: int) -> "PosteriorBatch":
        """One of the first batch axis."""
        return PosteriorBatch(self.groups, self.where[i])

    @cached_property
    def single(self) -> Posterior:
        """The only one, whose moments are made once; ValueError where it was left out."""
        if not self.groups:
            raise ValueError("this result is one without_posteriors(): ask the result from which that was made")
        group, row = self.where.tolist()
        explanation = self.groups[group]
        return Posterior(explanation, explanation.shares[row], row)
