"""How bright the lamps are at which a light probe is clipped, by the photograph of what they light.

Basis images are linear in the light, Y = Y_rest + f Y_lamps: a factor f of the clipped texels costs no rendering. Its
evidence is that of the estimator's priors, as for rotations; its prior is even on the logarithm from 1 to LARGEST.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, log, pi
from operator import itemgetter

import torch
from torch import Tensor

from torchbrdf.alignment._promise import likeliest, pixels_per_misfit, priors_of, promising
from torchbrdf.alignment._search import DOUBT, RotationSearch, Summit, Trial, distinct_columns
from torchbrdf.estimation import UnformedSpace, residual_scale
from torchbrdf.estimation.priors import Explanation, PriorBank, redundancy
from torchbrdf.light import Lamps, LightProbe
from torchbrdf.transport.harmonic import HarmonicBasis

LARGEST = 1e4
"""Times by which a lamp may be clipped."""

LARGEST_UNKNOWN = 1e7
"""The same of infinite texels, which hold no radiance of their own."""

COLOUR = 0.2
"""Standard deviation of the logarithm of a channel's factor about the mean of all."""

CLEAR = log(10)
"""Log odds above which lamps are believed to be clipped."""

TOLD = 0.3
"""Standard deviation of the logarithm up to which a photograph tells the radiance."""

_STEP = log(2)
"""Of the first guess."""

_MOST_STEPS = 8
_LONGEST_STEP = 0.7
_SMALLEST_STEP = 0.01
_NEAR = 0.4
"""Logarithm up to which another factor leaves the rotation where it is."""

_MOST_ROUNDS = 3

Climb = tuple[Summit, Trial, float]


@dataclass(frozen=True, eq=False)
class LampRadiance:
    """What a photograph tells of lamps at which a probe may be clipped.

    lamps     of the probe as it was given
    factors   (3,) float64: what their radiance is multiplied by; 1 where they are not clearly clipped
    std       (3,) float64: standard deviations of the natural logarithms, larger where the prior of colours tells most
    log_odds  natural logarithm of the odds that they are clipped rather than as bright as recorded; infinite where they
              were infinite
    """

    lamps: Lamps
    factors: Tensor
    std: Tensor
    log_odds: float

    @property
    def clipped(self) -> bool:
        """Whether the probe's lamps have another radiance than was recorded."""
        return self.log_odds > CLEAR

    @property
    def confident(self) -> bool:
        """Whether the photograph tells the radiance, also that it is as recorded."""
        return bool((self.std[self.lamps.channels] <= TOLD).all())

    @property
    def at_bound(self) -> bool:
        """Whether the factors are as large as was looked for."""
        largest = LARGEST_UNKNOWN if self.lamps.unknown else LARGEST
        return self.clipped and float(self.factors.max()) > largest / 2

    def is_near(self, other: "LampRadiance") -> bool:
        """Whether the light is much the same."""
        if not (self.clipped and other.clipped):
            return self.clipped == other.clipped
        return float((self.factors / other.factors).log().abs().max()) < _NEAR

    def relit(self, probe: LightProbe) -> LightProbe:
        """The probe with the radiance found, or as it is."""
        return probe.relit(self.factors) if self.clipped else probe

    def __str__(self) -> str:
        """One clause on what was found."""
        unsure = "" if self.confident else ", which this photograph cannot tell for sure"
        if not self.clipped:
            return f"its lamp of {self.lamps.about} left as it is{unsure}"
        pairs = zip(self.factors.tolist(), self.std.tolist(), strict=True)
        told = ", ".join(f"{factor:.3g} +- {100 * std:.0f} %" for factor, std in pairs)
        return f"its lamp of {self.lamps.about} brightened, in R, G, B by {told}{unsure}"


@dataclass(frozen=True, eq=False)
class _Lighting:
    """A photograph under a light whose lamps have factors.

    log_factors   (3,) float64
    explanation   of the photograph, by all priors
    log_evidence  of all priors together, divided as DOUBT says
    """

    log_factors: Tensor
    explanation: Explanation
    log_evidence: float


@dataclass(frozen=True, eq=False)
class _Shown:
    """What of the basis images under one rotation is by the lamps, and what by all other light, each (n, 3, P)."""

    rest: Tensor
    lamps: Tensor

    @classmethod
    def of(cls, task: RotationSearch, trial: Trial, columns: Sequence[int] | None = None) -> "_Shown":
        """Under the rotation of a trial, by the light of a search that may be another's; of some columns or all."""
        alone = task.lamps.packed_at(trial.rotation, columns)
        if trial.light is task.light:
            whole = trial.packed if columns is None else trial.packed[columns]
        else:
            whole = task.light.packed_at(trial.rotation, columns)
        alone, whole = alone[..., task.used], whole[..., task.used]
        return cls(whole - alone, alone)

    def of_columns(self, columns: Sequence[int]) -> "_Shown":
        """What some basis BRDFs show."""
        return _Shown(self.rest[columns], self.lamps[columns])


class LampSearch:
    """The evidence of one photograph as a function of the factors of the light's lamps, under one rotation.

    task     whose light has lamps
    shown    by that light
    columns  that are shown, with the priors of the whole library only; None for all, with all priors
    Residuals are divided by what the photograph itself shows, so that evidence of all factors compares.
    """

    def __init__(self, task: RotationSearch, shown: _Shown, columns: Sequence[int] | None = None) -> None:
        """Nothing is computed yet."""
        lamps = task.light.probe.lamps
        assert lamps is not None
        norms = task.light.library.gram.diagonal().sqrt().to(task.y)
        self._rest, self._lamps = shown.rest, shown.lamps
        self._norms = norms if columns is None else norms[columns]
        self.y, self.lamps, self._whole = task.y, lamps, columns is not None
        self.channels = lamps.channels.double()
        self._doubt = redundancy(DOUBT, self.y.shape[-1])
        self._scale = residual_scale(self.y[0], [self.y.shape[-1]])
        self._variances: Tensor | None = None
        self._kept: tuple[Tensor, Tensor] | None = None

    @cached_property
    def largest(self) -> float:
        """Logarithm of the largest factor."""
        return log(LARGEST_UNKNOWN if self.lamps.unknown else LARGEST)

    def at(self, log_factors: Tensor) -> _Lighting:
        """Solve for the weights."""
        factors = (log_factors * self.channels).exp().to(self._lamps)[:, None]
        space = UnformedSpace.weighted(self._rest + factors * self._lamps, self._scale)
        if self._variances is None:
            self._variances = priors_of(self._norms, space, self._whole)
        if self._kept is None or float((log_factors - self._kept[0]).abs().max()) > _NEAR:
            self._kept = log_factors, self._variances[promising(space, self._variances, self.y)]
        kept = self._kept[1]
        found = PriorBank.of(space, kept, correlation=1).explain(self.y)
        return _Lighting(log_factors, found, float(torch.logsumexp(found.log_evidence.flatten(), 0)) / self._doubt)

    @cached_property
    def as_recorded(self) -> _Lighting:
        """With no factor."""
        return self.at(torch.zeros(3, dtype=torch.float64))

    def scan(self) -> tuple[Tensor, Tensor]:
        """Logarithms of factors (K,), the same for all channels, and the log evidence of each."""
        steps = torch.arange(round(self.largest / _STEP) + 1, dtype=torch.float64) * _STEP
        return steps, torch.tensor([self.at(step.expand(3)).log_evidence for step in steps], dtype=torch.float64)

    def climb(self, log_factors: Tensor) -> tuple[_Lighting, Tensor]:
        """The top of the posterior near some factors, and minus its second derivatives (3, 3) there."""
        prior = self.prior

        def log_posterior(one: _Lighting) -> float:
            return one.log_evidence - 0.5 * float(one.log_factors @ prior @ one.log_factors)

        best, shorter = (self.at(log_factors) if bool(log_factors.any()) else self.as_recorded), 1.0
        for _ in range(_MOST_STEPS):
            gradient, precision = self._slope(best)
            gradient, precision = gradient - prior @ best.log_factors, precision + prior
            step = torch.linalg.solve(precision, gradient).clamp(-_LONGEST_STEP, _LONGEST_STEP) * self.channels
            new = best
            while True:
                goal = (best.log_factors + shorter * step).clamp(0, self.largest)
                if float((goal - best.log_factors).abs().max()) < _SMALLEST_STEP:
                    return best, precision
                new = self.at(goal)
                if log_posterior(new) > log_posterior(best):
                    break
                shorter /= 2
            best, shorter = new, min(1.0, 2 * shorter)
        return best, self._slope(best)[1] + prior

    @cached_property
    def prior(self) -> Tensor:
        """(3, 3): of deviations of the channels from their mean; a channel without lamps stays as it is."""
        mean = torch.outer(self.channels, self.channels) / self.channels.sum()
        return (torch.diag(self.channels) - mean) / COLOUR**2 + torch.diag(1 - self.channels)

    def _slope(self, lighting: _Lighting) -> tuple[Tensor, Tensor]:
        """First (3,) and minus second derivatives (3, 3) of the log evidence by log factors; see `RotationSearch`."""
        found, bank = lighting.explanation, lighting.explanation.bank
        m, penalty, weights = likeliest(found)
        factors = (lighting.log_factors * self.channels).exp().to(weights)
        change = (
            torch.einsum("sn,nsp->sp", weights, self._lamps.to(weights))
            * (factors * self.channels.to(weights))[:, None]
        )
        weighted, residual = change * bank.space.inverse, self.y[0] - bank.space.render(weights[None], torch.float64)[0]
        inside, energy = bank.space.project(change[None])
        seen = torch.einsum("sr,srk->sk", inside[0], bank.vectors[m])
        product = energy[0] - inside[0].square().sum(-1) + (seen.square() * bank.damping[m, :, penalty]).sum(-1)
        slope = (weighted * residual * bank.space.inverse).sum(-1)
        count = pixels_per_misfit(found, m, penalty, self._doubt)
        return (count * slope).cpu(), torch.diag(count * product).cpu()


def first_guess(task: RotationSearch, believed: Trial) -> LampRadiance | None:
    """One factor for all channels, by few materials under the rotation that is believed; None without lamps."""
    if task.light.probe.lamps is None:
        return None
    columns = distinct_columns(believed)
    return _guessed(task, _Shown.of(task, believed, columns), columns)


def _guessed(task: RotationSearch, shown: _Shown, columns: Sequence[int]) -> LampRadiance:
    search = LampSearch(task, shown, columns)
    steps, evidence = search.scan()
    posterior = torch.softmax(evidence, 0)
    mean = (posterior * steps).sum()
    spread = float((posterior * (steps - mean).square()).sum().sqrt())
    return LampRadiance(
        lamps=search.lamps,
        factors=(steps[evidence.argmax()] * search.channels).exp(),
        std=max(spread, _STEP / 2) * search.channels,
        log_odds=inf if search.lamps.unknown else float(evidence.logsumexp(0) - evidence[0]) - log(len(steps)),
    )


def with_lamp(
    task: RotationSearch, believed: Trial, lamp: LampRadiance, climb: Callable[[RotationSearch, Trial], Climb]
) -> tuple[RotationSearch, LampRadiance, Climb]:
    """The search under the probe with its lamps as found, what was found of them, and of the rotation.

    lamp   the `first_guess`
    climb  finds the rotation, from the trial that is believed: a summit, the best trial, the odds of a turn
    """
    given, evaluations = task, 0
    recorded = replace(lamp, factors=torch.ones_like(lamp.factors), log_odds=-inf)
    found: list[tuple[float, LampRadiance, Climb]] = []
    for start in (lamp, recorded) if lamp.clipped else (lamp,):
        current, settled = start, False
        for _ in range(_MOST_ROUNDS):
            task = _lit(given, current)
            climbed = climb(task, task.trial(believed.rotation) if current.clipped else believed)
            evaluations += task.evaluations if task is not given else 0
            shown = _Shown.of(given, climbed[1])
            columns = distinct_columns(climbed[1])
            guess = lamp if climbed[1] is believed else _guessed(given, shown.of_columns(columns), columns)
            before, (current, evidence) = current, _radiance_at(given, shown, guess)
            settled = current.is_near(before)
            if settled:
                break
        found.append((evidence, current, climbed))
        if settled and not current.at_bound:
            break
    _, lamp, (summit, best, log_odds) = max(found, key=itemgetter(0))
    if lamp.at_bound and not lamp.lamps.unknown:  # no top, but light that the photograph explains no other way
        lamp = replace(recorded, std=log(LARGEST) * lamp.lamps.channels.double(), log_odds=0.0)
    task = _lit(given, lamp)
    if best.light is not task.light:
        best = task.trial(best.rotation)
    task.evaluations += evaluations + (given.evaluations if task is not given else 0)
    return task, lamp, (summit, best, log_odds)


def _lit(given: RotationSearch, lamp: LampRadiance) -> RotationSearch:
    """The search under the probe as it was given, its lamps brightened."""
    if not lamp.clipped:
        return given
    light = HarmonicBasis(given.light.library, lamp.relit(given.light.probe), given.light.view)
    return RotationSearch(light, given.y, given.used, given.expected)


def _radiance_at(task: RotationSearch, shown: _Shown, guess: LampRadiance) -> tuple[LampRadiance, float]:
    """The factors of the lamps of the probe of a search, under one rotation, from a guess; their log evidence."""
    search = LampSearch(task, shown)
    top, precision = search.climb(guess.factors.log())
    count = int(search.channels.sum())
    precision = precision + torch.outer(search.channels, search.channels) * 12 / (count * search.largest) ** 2  # even
    by_prior = search.prior.diagonal() / precision.diagonal()  # of a channel that the material hardly reflects
    std = (torch.linalg.inv(precision).diagonal() + by_prior * COLOUR**2).sqrt() * search.channels
    if guess.lamps.unknown:
        return LampRadiance(guess.lamps, top.log_factors.exp(), std, inf), top.log_evidence
    away = top.log_factors * search.channels
    away = (away - away.sum() / count) * search.channels
    log_prior = -log(search.largest * count**0.5) - (count - 1) * log(COLOUR * (2 * pi) ** 0.5)
    log_prior -= 0.5 * float(away.square().sum()) / COLOUR**2
    volume = 0.5 * (count * log(2 * pi) - float(torch.logdet(precision)))
    as_recorded = search.as_recorded.log_evidence
    odds = top.log_evidence + log_prior + volume - as_recorded
    if odds > CLEAR:
        return LampRadiance(guess.lamps, top.log_factors.exp(), std, odds), top.log_evidence
    return LampRadiance(guess.lamps, torch.ones(3, dtype=torch.float64), guess.std, odds), as_recorded
