"""The bank of all priors, factored, and how well each explains a photograph.

A prior says w ~ N(a mu, tau^2 diag(S)): materials look like a scaled mean, and deviate by some basis BRDFs more than
by others. [CBP21] has one for each class; here are the classes, the whole library, and neighbourhoods of materials
that look alike under this light: a mixture of Gaussians over the manifold of materials. Each has a grid of penalties
lambda = sigma^2 / tau^2, and all are averaged by a power of their evidence [Mac92, Gru12], so nothing is tuned by hand,
and nothing is chosen that the photograph does not tell apart.

Shapes: M priors, L penalties, n basis BRDFs, r coordinates of the image space, B photographs.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from torchbrdf.brdf import lower_gram
from torchbrdf.estimation.eigenpairs import eigh
from torchbrdf.estimation.image_space import ImageSpace
from torchbrdf.lasting import lasting

PENALTIES = torch.logspace(-5.5, 1, 9, dtype=torch.float64)
"""lambda of every prior, in units of trace(R S R^T) / n. Smaller ones amplify rounding and win nothing."""

CORRELATION = 8.0
"""Neighbouring residuals are not independent, beside what `smooth_errors` are: this many pixels of a sphere of 64 x 64
say as much as one. Chosen in docs/ablation.md."""

_SPHERE = 3080
"""The pixels of that sphere. Fewer pixels lie farther apart, and say more each."""

TRUSTED = 2.0
"""Which prior and penalty are right, a photograph tells as surely as this many independent pixels, however many it has:
every prior is wrong, and in the same way at every pixel. Also in docs/ablation.md."""

NOISE_FLOOR = 0.003
"""Basis images and photographs are wrong by at least this share, however well they agree."""

_SMALLEST_VARIANCE = 1e-6
"""Of a basis BRDF in a constrained solve, relative to the mean of all, for its precision to be finite."""


def redundancy(correlation: float, pixels: int, photographs: int = 1) -> float:
    """How many pixels say as much as one, where `correlation` of a sphere of 64 x 64 do."""
    return 1 + (correlation - 1) * pixels / (_SPHERE * photographs)


@dataclass(frozen=True, eq=False)
class PriorBank:
    """The factors of all priors in an image space; they do not depend on the photograph.

    space      the image space
    variances  (M, n)        S
    means      (M, n)        mu, the sum of each is 1
    values     (M, 3, r)     eigenvalues of R S R^T
    vectors    (M, 3, r, r)  its eigenvectors V
    penalties  (M, 3, L)     lambda
    mean_images (M, 3, r)    V^T R mu
    damping     (M, 3, L, r) lambda / (lambda + eigenvalue)
    correlation see CORRELATION
    """

    space: ImageSpace
    variances: Tensor
    means: Tensor
    values: Tensor
    vectors: Tensor
    penalties: Tensor
    mean_images: Tensor
    damping: Tensor
    correlation: float = CORRELATION

    @classmethod
    def of(cls, space: ImageSpace, variances: Tensor, correlation: float = CORRELATION) -> "PriorBank":
        """Factor priors (M, n) in a space."""
        n = variances.shape[1]
        means = variances.sqrt()
        means = means / means.sum(1, keepdim=True)
        values, vectors = eigh(lower_gram(space.white * variances.sqrt()[:, None, None]))
        values = values.clamp_min(0)
        trace = values.sum(-1, keepdim=True) / n
        penalties = PENALTIES.to(values.device) * torch.where(trace > 0, trace, 1)
        mean_images = (vectors.mT @ (space.white @ means.mT).permute(2, 0, 1)[..., None])[..., 0]
        damping = penalties[..., None] / (values[..., None, :] + penalties[..., None])
        return cls(space, variances, means, values, vectors, penalties, mean_images, damping, correlation)

    @cached_property
    @lasting
    def log_damping(self) -> Tensor:
        """(M, 3, L): sum of log damping over the directions."""
        return self.damping.log().sum(-1)

    @property
    def independent_pixels(self) -> float:
        """How many independent pixels say as much as those of the space."""
        pixels = self.space.scale.shape[-1]
        return pixels / redundancy(self.correlation, pixels, self.space.photographs)

    @property
    def temperature(self) -> float:
        """What log evidence is divided by, for a photograph to count as TRUSTED pixels."""
        return max(1.0, self.independent_pixels / (TRUSTED * self.space.photographs))

    def masked(self, used: Tensor) -> "PriorBank":
        """The same priors in the space of some pixels only."""
        return PriorBank.of(self.space.masked(used), self.variances, self.correlation)

    def explain(self, y: Tensor) -> "Explanation":
        """How every prior and penalty explains photographs (B, 3, P)."""
        coordinates, energy = self.space.project(y)
        outside = (energy - coordinates.square().sum(-1)).clamp_min(0) + NOISE_FLOOR**2 * energy
        white = self.space.whitened(coordinates.permute(1, 2, 0)).mT
        rotated = white @ self.vectors  # (M, 3, B, r), the order that products like best
        image = self.mean_images[:, :, None]
        squared = image.square().sum(-1)
        brightness = (rotated * image).sum(-1) / torch.where(squared > 0, squared, 1)
        deviation = rotated - brightness[..., None] * image
        quadratic = outside.mT[..., None] + deviation.square() @ self.damping.mT
        lit = (energy > 0).mT[..., None]
        misfit = self.independent_pixels * torch.where(lit, quadratic, 1).log()
        evidence = 0.5 * (self.log_damping[:, :, None] - misfit)
        log_evidence = torch.where(lit, evidence, 0).sum(1).transpose(0, 1)
        brightness, deviation, quadratic = (part.movedim(2, 0) for part in (brightness, deviation, quadratic))
        return Explanation(self, brightness, deviation, quadratic, log_evidence)


@dataclass(frozen=True, eq=False, repr=False)
class Explanation:
    """Photographs as every prior and penalty explains them.

    brightness    (B, M, 3)     a
    deviation     (B, M, 3, r)  V^T of the photograph less a times the prior's mean image
    quadratic     (B, M, 3, L)  |residual|^2 + lambda |w - a mu|^2_S at the solution
    log_evidence  (B, M, L)     of all channels together; they share prior and penalty
    """

    bank: PriorBank
    brightness: Tensor
    deviation: Tensor
    quadratic: Tensor
    log_evidence: Tensor

    def __repr__(self) -> str:
        """How many photographs, priors and penalties."""
        photographs, priors, penalties = self.log_evidence.shape
        return f"Explanation({photographs} photographs, {priors} priors, {penalties} penalties each)"

    @cached_property
    def _tempered(self) -> Tensor:
        return self.log_evidence / self.bank.temperature

    @cached_property
    def of_penalties(self) -> Tensor:
        """(B, M, L): probabilities of the penalties of each prior."""
        return torch.softmax(self._tempered, -1)

    @cached_property
    def of_priors(self) -> Tensor:
        """(B, M): probabilities of the priors."""
        return torch.softmax(torch.logsumexp(self._tempered, -1), -1)

    def of_classes(self, k: int) -> Tensor:
        """(B, K): probabilities of the first K priors, the classes, with all penalties, given that one is right."""
        return torch.softmax(torch.logsumexp(self.log_evidence[:, :k], -1) / self.bank.temperature, -1)

    @cached_property
    def shares(self) -> Tensor:
        """(B, M, L): probabilities of all pairs of prior and penalty."""
        return self.of_priors[..., None] * self.of_penalties

    @property
    def mean(self) -> Tensor:
        """(B, 3, n): the posterior mean of the weights."""
        return self.mean_and_first(0)[0]

    def mean_and_first(self, count: int) -> tuple[Tensor, Tensor]:
        """The posterior mean (B, 3, n), and what each of the first K priors says alone (B, K, 3, n)."""
        bank, towards, level = self.bank, *self._filtered(self.of_penalties)
        first = self._weights(towards[:, :count], level[:, :count])
        probability = self.of_priors.mT  # (M, B)
        likely = (towards * probability[..., None]).flatten(1, 2)
        deviations = (likely @ bank.space.white).unflatten(1, towards.shape[1:3])
        deviation = deviations.mul_(bank.variances[:, None]).sum(1)  # in place: this is all of the memory
        return (deviation + (level * probability).mT @ bank.means).transpose(0, 1), first

    def components(self, shares: Tensor) -> Tensor:
        """Each prior's part (B, M, 3, n) of the posterior mean, for shares (B, M, L)."""
        return self._weights(*self._filtered(shares))

    def _filtered(self, shares: Tensor) -> tuple[Tensor, Tensor]:
        """Of each prior's part level mu + S R^T t, for shares (B, M, L): t (3, M, B, r), and the level (3, M, B)."""
        bank = self.bank
        weight = shares.transpose(0, 1)[:, None] / bank.penalties[:, :, None]  # (M, 3, B, L)
        filtered = (weight @ bank.damping) * self.deviation.movedim(0, 2)
        towards = (filtered @ bank.vectors.mT).transpose(0, 1)
        return towards, shares.sum(-1).mT * self.brightness.movedim(0, -1).transpose(0, 1)

    def _weights(self, towards: Tensor, level: Tensor) -> Tensor:
        """(B, M, 3, n) of the first M priors from what `_filtered` gives, by one product with R for all of them."""
        bank, count = self.bank, towards.shape[1]
        deviations = (towards.flatten(1, 2) @ bank.space.white).unflatten(1, towards.shape[1:3])
        parts = bank.variances[:count, None] * deviations + level[..., None] * bank.means[:count, None]
        return parts.permute(2, 1, 0, 3)

    def precision(self, shares: Tensor) -> Tensor:
        """R^T R + T^-1 (B, 3, n, n), with T the prior variances S / lambda averaged by shares (B, M, L).

        The metric of no single pair would do for the average: a neighbourhood hardly lets materials far from it move.
        """
        bank = self.bank
        variances = torch.einsum("bml,msl,mn->bsn", shares, 1 / bank.penalties, bank.variances)
        least = _SMALLEST_VARIANCE * variances.mean(-1, keepdim=True)
        return bank.space.white.mT @ bank.space.white + torch.diag_embed(1 / torch.maximum(variances, least))

    def detach(self) -> "Explanation":
        """The same without gradients."""
        parts = (self.brightness, self.deviation, self.quadratic, self.log_evidence)
        return Explanation(self.bank, *(part.detach() for part in parts))
