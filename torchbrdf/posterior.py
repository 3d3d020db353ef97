"""What the photograph leaves open: the posterior of the weights, a mixture of Gaussians."""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.prior_bank import CORRELATION, Explanation

_LEAST = 1e-3
"""Pairs of prior and penalty of less probability than this do not enter variances."""


@dataclass(frozen=True, eq=False)
class Gaussian:
    """One part of the mixture: weights ~ N(mean, scale diag(variances) - gain gain^T) in each colour channel.

    share  its probability
    mean (3, n), scale (3,), variances (n,), gain (3, n, r)
    """

    share: float
    mean: Tensor
    scale: Tensor
    variances: Tensor
    gain: Tensor


@dataclass(frozen=True, eq=False)
class Posterior:
    """The posterior of the weights of one photograph.

    explanation    of a batch of photographs that holds it, without gradients
    probabilities  (M, L) of prior and penalty
    row            its place in the batch
    pixels         how many pixels were used
    """

    explanation: Explanation
    probabilities: Tensor
    row: int
    pixels: int

    def variance(self, rows: Tensor) -> Tensor:
        """Variances of linear functions of the weights, the spread between the parts of the mixture included.

        rows     (N, n) or (3, N, n)  one function a row, the same or its own for each colour channel
        returns  (3, N)  Var[rows w] of each channel
        """
        rows = rows.expand(3, -1, -1) if rows.ndim == 2 else rows
        rows = rows.to(self.explanation.bank.variances)
        within, spread, average = (rows.new_zeros(rows.shape[:-1]) for _ in range(3))
        for part in self.parts():
            seen = rows @ part.gain
            within += part.share * (part.scale[:, None] * (rows.square() @ part.variances) - seen.square().sum(-1))
            mean = (rows @ part.mean[..., None])[..., 0]
            spread += part.share * mean.square()
            average += part.share * mean
        return within.clamp_min(0) + (spread - average.square()).clamp_min(0)

    def covariance(self) -> Tensor:
        """(3, n, n) of the weights of each channel."""
        n = self.explanation.bank.variances.shape[1]
        total = self.explanation.bank.variances.new_zeros(3, n, n)
        average = total.new_zeros(3, n)
        for part in self.parts():
            within = torch.diag_embed(part.scale[:, None] * part.variances) - part.gain @ part.gain.mT
            total += part.share * (within + part.mean[..., None] * part.mean[:, None])
            average += part.share * part.mean
        return total - average[..., None] * average[:, None]

    def parts(self) -> Iterator[Gaussian]:
        """The Gaussians worth the name; their shares add up to 1."""
        found, row = self.explanation, self.row
        bank = found.bank
        pairs = torch.nonzero(self.probabilities > min(_LEAST, float(self.probabilities.max()) / 2))
        shares = self.probabilities[pairs[:, 0], pairs[:, 1]]
        for (m, k), share in zip(pairs.tolist(), (shares / shares.sum()).tolist(), strict=True):
            penalty = bank.penalties[m, :, k]
            spectrum = bank.values[m] + penalty[:, None]
            scale = CORRELATION * found.quadratic[row, m, :, k] / self.pixels / penalty
            directions = bank.variances[m][:, None] * (bank.space.r.mT @ bank.vectors[m])
            mean = found.brightness[row, m][:, None] * bank.means[m]
            mean = mean + (directions @ (found.deviation[row, m] / spectrum)[..., None])[..., 0]
            gain = directions * (scale[:, None] / spectrum).sqrt()[:, None]
            yield Gaussian(share, mean, scale, bank.variances[m], gain)


@dataclass(frozen=True, eq=False)
class PosteriorBatch:
    """The posteriors of a batch of photographs.

    groups  photographs that share a mask: their explanation, probabilities (B, M, L) and number of pixels
    where   (*batch, 2)  int64: group and row of each photograph
    """

    groups: tuple[tuple[Explanation, Tensor, int], ...]
    where: Tensor

    def __getitem__(self, i: int) -> "PosteriorBatch":
        """One of the first batch axis."""
        return PosteriorBatch(self.groups, self.where[i])

    @property
    def single(self) -> Posterior:
        """The only one."""
        group, row = self.where.tolist()
        explanation, probabilities, pixels = self.groups[group]
        return Posterior(explanation, probabilities[row], row, pixels)
