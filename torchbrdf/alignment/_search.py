"""How well a photograph is explained under a light probe in any orientation, and the way uphill.

Under every rotation the weights are solved for anew, with the estimator's priors, and the evidence tells how well the
light explains the photograph (variable projection [GP73]). It is highest near the true rotation and falls off steadily
for many degrees around it, because a wrong light looks like a rougher material. So Gauss-Newton steps find the top: the
change of the image as the light turns counts where no weights can imitate it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import exp, inf, log, radians
from operator import attrgetter

import torch
from torch import Tensor

from torchbrdf.alignment._ascent import SMALLEST_STEP, ascend
from torchbrdf.alignment._promise import likeliest, pixels_per_misfit, priors_of, promising
from torchbrdf.estimation import UnformedSpace, residual_scale
from torchbrdf.estimation.priors import (
    Explanation,
    PriorBank,
    farthest_points,
    image_angles,
    redundancy,
)
from torchbrdf.light import LightProbe, rotation_angle, rotation_of, rotation_vector
from torchbrdf.transport import BasisImages
from torchbrdf.transport.harmonic import HarmonicBasis

DOUBT = 100.0
"""What the evidence of rotations is divided by for a sphere of 64 x 64 pixels, see `redundancy`. Every pixel counts in
it, but what no material of the library explains is the same in neighbouring pixels and changes as the light turns
(docs/alignment.md)."""

MOST_STEPS = 12

_SAME_CHANGE = radians(1)
"""Turn up to which the change of an image with turns is corrected rather than rendered anew."""

_SAME_HILL = radians(0.3), radians(1)
"""Turns from a summit that are on its hill for sure, and at most where a climb came three quarters of the way to it."""

RIVAL = 10.0
"""Log evidence by which a place may be behind the best and still matter."""

_NEGLIGIBLE = 0.01
"""Squared standard deviations of the posterior up to which a step is not worth another evaluation."""

_SAME_PRIORS = radians(0.3)
"""Turn up to which the same priors are promising."""

_COARSE_COLUMNS = 16
_COARSE_LINES, _COARSE_ROWS, _COARSE_FREQUENCIES = 288, 64, 64
"""Basis BRDFs that look different, which a coarse search compares; lines of its light, rows of texels, and
frequencies in azimuth."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A photograph as it is explained under one rotation of the light.

    rotation      (3, 3) float64
    light         that is turned
    packed        (n, 3, P): basis images under it
    y             (1, 3, P) float64: the photograph
    explanation   of the photograph, by all priors
    log_evidence  of all priors together, divided as DOUBT says
    """

    rotation: Tensor
    light: HarmonicBasis
    packed: Tensor
    y: Tensor
    explanation: Explanation
    log_evidence: float

    @property
    def basis(self) -> BasisImages:
        """The basis images, with what they are of."""
        return self.light.named(self.packed, self.rotation)


@dataclass(frozen=True, eq=False)
class Summit:
    """Where a climb ended.

    trial         the best
    precision     (3, 3) float64: minus the second derivatives of the log posterior by turns about +X, +Y, +Z,
                  1/radian^2
    log_evidence  of all rotations around it together, each weighted by the prior around where the climb began: the
                  log posterior at the best, and the volume of the Gaussian of `precision` over the prior's (Laplace)
    converged     whether the last step was short enough; not where steps ran out, or none of any length led higher
    hope          what a climb from where this one began might gain
    ahead         (3, 3): the trial's rotation and the last step, which was too short to take
    """

    trial: Trial
    precision: Tensor
    log_evidence: float
    converged: bool
    hope: float = 0.0
    ahead: Tensor | None = None

    def outdoes(self, trial: Trial, gain: float, reach: float) -> bool:
        """Whether a trial cannot become another summit that matters, were its evidence higher by a gain.

        reach  in radians, or 3 standard deviations where that is farther: so near a trial is on the same hill,
               and another summit only if higher by more than climbs leave to their tops
        """
        away = rotation_vector(trial.rotation @ self.trial.rotation.T)
        behind = self.trial.log_evidence - trial.log_evidence
        near = float(away.norm()) < reach or float(away @ self.precision @ away) < 9
        return behind - gain > RIVAL or (near and behind >= -_NEGLIGIBLE)


@dataclass(frozen=True, eq=False)
class _Changes:
    """How the image at a trial's solution changes with turns, (3, 3, P), and under which rotation that was rendered."""

    trial: Trial
    change: Tensor
    rendered: Tensor


def distinct_columns(trial: Trial) -> list[int]:
    """Basis BRDFs that look different under what is believed of the light, in order."""
    return sorted(farthest_points(image_angles(trial.explanation.bank.space), _COARSE_COLUMNS, 0))


def best_of(summits: Sequence[Summit]) -> Summit:
    """The summit of the highest evidence, with what the others leave open: each a place as probable as its evidence."""
    best = max(summits, key=attrgetter("log_evidence"))
    covariance = torch.linalg.inv(best.precision)
    for other in summits:
        away = rotation_vector(other.trial.rotation @ best.trial.rotation.T)
        odds = exp(other.log_evidence - best.log_evidence)
        covariance = covariance + odds / (1 + odds) * torch.outer(away, away)
    return replace(best, precision=torch.linalg.inv(covariance))


class RotationSearch:
    """The evidence of one photograph as a function of the light's rotation.

    light     basis images in any orientation
    y         (1, 3, P) float64, the pixels used
    used      (P,) bool, of the pixels of the view
    expected  standard deviation in radians about each axis of how far the light is turned from where a climb starts
    whole     with the priors of the whole library only
    What residuals are divided by, and the priors, are those of the first rotation tried, so that evidence compares.
    """

    def __init__(
        self, light: HarmonicBasis, y: Tensor, used: Tensor, expected: float, whole: bool = False
    ) -> None:
        """Nothing is computed yet."""
        self.light, self.y, self.used, self.expected, self._whole = light, y, used.to(y.device), expected, whole
        self.evaluations = 0
        self._doubt = redundancy(DOUBT, y.shape[-1])
        self._frame: tuple[Tensor, Tensor] | None = None
        self._changes: _Changes | None = None
        self._kept: tuple[Tensor, Tensor] | None = None

    def coarse(self, believed: Trial) -> "RotationSearch":
        """With materials that look different under what is believed of the light, which is less fine."""
        probe = self.light.probe
        if probe.height > _COARSE_ROWS:
            probe = probe.resized(_COARSE_ROWS)
        light = HarmonicBasis(
            self.light.library,
            probe,
            self.light.view,
            lines=_COARSE_LINES,
            most=_COARSE_FREQUENCIES,
            columns=distinct_columns(believed),
        )
        return RotationSearch(light, self.y, self.used, self.expected, whole=True)

    @cached_property
    def lamps(self) -> HarmonicBasis:
        """The light of the lamps alone, of a probe that has them."""
        lamps = self.light.probe.lamps
        assert lamps is not None
        return HarmonicBasis(self.light.library, LightProbe(lamps.radiance), self.light.view)

    def under(self, probe: LightProbe) -> "RotationSearch":
        """The same photograph under another probe, with evidence that compares."""
        light = HarmonicBasis(self.light.library, probe, self.light.view)
        other = RotationSearch(light, self.y, self.used, self.expected)
        other._frame = self._frame
        return other

    def seeing(self, y: Tensor) -> "RotationSearch":
        """Another photograph (1, 3, P) of the same pixels, with evidence that compares."""
        other = RotationSearch(self.light, y, self.used, self.expected)
        other._frame, other.evaluations = self._frame, self.evaluations
        return other

    @property
    def weight(self) -> float:
        """How many independent pixels the evidence counts."""
        return self.y.shape[-1] / self._doubt

    def trial(self, rotation: Tensor, y: Tensor | None = None, every: bool = False) -> Trial:
        """Solve for the weights under one rotation; of another photograph (1, 3, P) where one is given.

        every  prior is kept, for photographs that promise other ones
        """
        return self._solved(rotation, self.light.packed_at(rotation), y, every)

    def trials(self, rotations: Sequence[Tensor]) -> list[Trial]:
        """`trial` of each."""
        packed = self.light.packed_at_each(rotations)
        return [self._solved(*pair, None, False) for pair in zip(rotations, packed, strict=True)]

    def _solved(self, rotation: Tensor, whole: Tensor, y: Tensor | None, every: bool) -> Trial:
        """A trial under a rotation with the basis images (n, 3, P) under it."""
        packed = whole if bool(self.used.all()) else whole[..., self.used]
        if self._frame is None:
            scale = residual_scale(packed.mean(0, dtype=torch.float64), [packed.shape[-1]])
            space = UnformedSpace.weighted(packed, scale)
            self._frame = scale, self._priors(space)
        else:
            space = UnformedSpace.weighted(packed, self._frame[0])
        variances, moved = self._frame[1], y is not None
        y = self.y if y is None else y
        if every:
            kept = variances
        elif moved or self._kept is None or rotation_angle(rotation @ self._kept[0].T) > _SAME_PRIORS:
            kept = variances[promising(space, variances, y)]
            self._kept = None if moved else (rotation, kept)
        else:
            kept = self._kept[1]
        self.evaluations += 1
        return self._explained(rotation, whole, PriorBank.of(space, kept, correlation=1), y)

    def with_photograph(self, trial: Trial, y: Tensor) -> Trial:
        """The same with another photograph (1, 3, P): a hundredth of the cost."""
        return self._explained(trial.rotation, trial.packed, trial.explanation.bank, y)

    def _explained(self, rotation: Tensor, packed: Tensor, bank: PriorBank, y: Tensor) -> Trial:
        found = bank.explain(y)
        log_evidence = float(torch.logsumexp(found.log_evidence.flatten(), 0)) / self._doubt
        return Trial(rotation, self.light, packed, y, found, log_evidence)

    def climb_beside(self, start: Trial, known: Summit, hope: float = inf) -> Summit | None:
        """`climb`; None where that leads to a summit that is known, or to none that matters beside it.

        hope  what it may gain, where that is known
        """
        sure, most = _SAME_HILL
        reach = max(sure, min(most, rotation_angle(start.rotation @ known.trial.rotation.T) / 4))
        if known.outdoes(start, hope, reach):
            return None
        summit = self.climb(start, ends=lambda trial, gain: known.outdoes(trial, gain, reach))
        return None if known.outdoes(summit.trial, 0.0, reach) else summit

    def climb(
        self,
        start: Trial,
        shortest: float = SMALLEST_STEP,
        ends: Callable[[Trial, float], bool] = lambda trial, gain: False,
    ) -> Summit:
        """Gauss-Newton steps from a trial, shorter ones where the posterior did not grow; see `ascend`."""
        origin = start.rotation
        prior = torch.eye(3, dtype=torch.float64) / self.expected**2

        def turn(trial: Trial) -> Tensor:
            return rotation_vector(trial.rotation @ origin.T)

        def log_posterior(trial: Trial) -> float:
            return trial.log_evidence - 0.5 * float(turn(trial) @ prior @ turn(trial))

        def slope(trial: Trial) -> tuple[Tensor, Tensor]:
            gradient, precision = self._slope(trial)
            return gradient - prior @ turn(trial), precision + prior

        top = ascend(
            start,
            log_posterior,
            slope,
            lambda trial, step: self.trial(rotation_of(step) @ trial.rotation),
            1.0,
            MOST_STEPS,
            shortest,
            _NEGLIGIBLE,
            ends,
        )
        volume = -0.5 * (float(torch.logdet(top.precision)) + 6 * log(self.expected))
        ahead = rotation_of(top.step) @ top.best.rotation
        return Summit(top.best, top.precision, top.height + volume, top.converged, top.hope, ahead)

    def _slope(self, trial: Trial) -> tuple[Tensor, Tensor]:
        """First (3,) and minus second derivatives (3, 3) of the log evidence by turns."""
        return self.derivatives(trial, self.turns(trial))

    def turns(self, trial: Trial) -> Tensor:
        """(3, 3, P): how the image at the solution changes with turns about +X, +Y and +Z, per radian.

        Near where it was rendered last it is corrected by what the two solutions show of it [Bro65].
        """
        weights, last = likeliest(trial.explanation)[2], self._changes
        turn = torch.zeros(3) if last is None else rotation_vector(trial.rotation @ last.trial.rotation.T)
        if last is not None and bool(turn.any()) and rotation_angle(trial.rotation @ last.rendered.T) < _SAME_CHANGE:
            moved = (trial.packed - last.trial.packed)[..., self.used]
            missed = torch.einsum("sn,nsp->sp", weights.to(moved), moved).double()
            missed = missed - torch.einsum("a,asp->sp", turn.to(missed), last.change)
            change = last.change + (turn / turn.square().sum()).to(missed)[:, None, None] * missed
            self._changes = _Changes(trial, change, last.rendered)
        else:
            change = self.light.change_at(weights.mT, trial.rotation)[..., self.used].double()
            self._changes = _Changes(trial, change, trial.rotation)
        return change

    def derivatives(self, trial: Trial, change: Tensor) -> tuple[Tensor, Tensor]:
        """First (K,) and minus second derivatives (K, K) of the log evidence, with the best prior and penalty.

        change  (K, 3, P): of the image at the solution, or minus those of the photograph
        With M = Y S Y^T / lambda + 1, residual r, and changes J of the image at the solution, the evidence is
        -1/2 sum over channels of P log(y^T M^-1 y), so these are P r^T J / (y^T M^-1 y) and P J^T M^-1 J / (...).
        """
        found, bank = trial.explanation, trial.explanation.bank
        m, penalty, weights = likeliest(found)
        weighted, residual = change * bank.space.inverse, trial.y - bank.space.render(weights[None], torch.float64)
        inside, _ = bank.space.project(change)
        seen = torch.einsum("asr,srk->ask", inside, bank.vectors[m])
        product = torch.einsum("asp,bsp->sab", weighted, weighted) - torch.einsum("asr,bsr->sab", inside, inside)
        product = product + torch.einsum("ask,sk,bsk->sab", seen, bank.damping[m, :, penalty], seen)
        slope = torch.einsum("asp,sp->sa", weighted, residual[0] * bank.space.inverse)
        count = pixels_per_misfit(found, m, penalty, self._doubt)
        return (count @ slope).cpu(), torch.einsum("s,sab->ab", count, product).cpu()

    def _priors(self, space: UnformedSpace) -> Tensor:
        norms = self.light.library.gram.diagonal().sqrt()[self.light.columns]
        return priors_of(norms.to(space.scale), space, self._whole)
