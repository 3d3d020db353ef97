"""How well a photograph is explained under a light in any orientation, wherever its ball's silhouette is.

Basis images show a ball that fills their view, so a silhouette moves the photograph, not them: what changes with it is
the observation y, and the residual by as much. Under one rotation of the light, trying silhouettes is nearly free.
The outline that is seen as an edge is a second witness, which no material misleads.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.alignment._ascent import ascend
from torchbrdf.alignment._search import MOST_STEPS, RotationSearch, Trial
from torchbrdf.light import rotation_of, rotation_vector
from torchbrdf.photograph import REACH, MovingSilhouette

EXPECTED = 0.03
"""Standard deviation, in radii, of how far a silhouette is moved to each side, and its radius grown, before the
photograph is seen."""

TOO_SURE = torch.tensor([2.0, 2.0, 4.0], dtype=torch.float64)
"""Standard deviations of evidence, for x, y and radius, by which it is off: the rims of materials that no library holds
pass for those of larger or smaller balls."""

UNKNOWN = 0.25
"""Standard deviation of the radiance beside the ball from any that a material explains, in parts of the ball's; at most
as much as radiance differs across the silhouette: in a fog as bright as the ball nothing tells where it ends."""

_RIM = 0.07
"""Share of the pixels of a view, the outermost, that are its rim."""

_LEAST = torch.finfo(torch.float64).tiny

_BLUNT = 0.6
"""Pixels of the view over which edges are smeared before a silhouette is found exactly: they stop no climb then."""

_LONGEST_STRETCH = 8.0
_MOST_STEPS = 30
"""Of a silhouette alone, whose steps cost little, and are too short where an edge lies close."""


@dataclass(frozen=True, eq=False)
class Sight:
    """A photograph as it is explained with one silhouette, under one rotation of the light.

    shift         (3,) float64, as `MovingSilhouette` takes it
    log_evidence  of the trial, and of the background that the silhouette leaves outside
    """

    trial: Trial
    shift: Tensor
    log_evidence: float


@dataclass(frozen=True, eq=False)
class SightSummit:
    """Where a climb ended, as `Summit`; the precision (6, 6) or (3, 3) is by turns, and by shifts behind them.

    height      the log posterior at the best
    turn_prior  its part that is the prior of the rotation
    """

    sight: Sight
    precision: Tensor
    height: float
    turn_prior: float
    log_evidence: float
    converged: bool


class SilhouetteSearch:
    """The evidence of one photograph as a function of the light's rotation and the ball's silhouette.

    rotations  evidence of rotations, of the pixels that the silhouette can move
    moving     what the photograph shows
    edge       the shift (3,) to the outline that is seen, and its standard deviations (3,); None for any that is near
    Evidence is not made less sure here, where it is that of rotations, too: the edge is made surer, as TOO_SURE says.
    The pixels of the view are the same for all silhouettes, but not those of the photograph: a smaller one would win
    by leaving out the rim, which is hard to explain. So what lies outside is explained, too, as UNKNOWN radiance. The
    evidence of a pixel counts as often as pixels of the photograph lie inside, and what is left for those outside.
    """

    def __init__(
        self, rotations: RotationSearch, moving: MovingSilhouette, edge: tuple[Tensor, Tensor] | None = None
    ) -> None:
        """Nothing is computed yet."""
        self.rotations, self.moving, self.edge = rotations, moving, edge
        none = torch.zeros(3, dtype=torch.float64)
        self._expected, self._sigma = (none, none + EXPECTED) if edge is None else (edge[0], edge[1] / TOO_SURE)
        rim = _rim(rotations.light.view.mask)
        self._rim = rim[moving.used]
        self._seen_rim = float(moving.used[rim].double().mean())
        self._outside: float | None = None

    def sight(self, rotation: Tensor, shift: Tensor) -> Sight:
        """Solve for the weights under one rotation, with one silhouette."""
        return self.of(self.rotations.trial(rotation, self._y(shift)), shift)

    def moved(self, sight: Sight, shift: Tensor) -> Sight:
        """With another silhouette, under the same rotation."""
        return self.of(self.rotations.with_photograph(sight.trial, self._y(shift)), shift)

    def climb(self, start: Sight, turning: bool) -> SightSummit:
        """Gauss-Newton steps from a sight: of rotation and silhouette together, or of the silhouette alone."""
        origin = start.trial.rotation
        sigma = torch.cat([torch.full((3 * turning,), self.rotations.expected, dtype=torch.float64), self._sigma])

        def place(sight: Sight) -> Tensor:
            away = sight.shift - self._expected
            return torch.cat([rotation_vector(sight.trial.rotation @ origin.T), away]) if turning else away

        def height(sight: Sight) -> float:
            if float(sight.shift.abs().max()) > REACH:
                return -float("inf")
            return sight.log_evidence - 0.5 * float((place(sight) / sigma).square().sum())

        def slope(sight: Sight) -> tuple[Tensor, Tensor]:
            change = -self.moving.change(sight.shift).to(sight.trial.y)
            if turning:
                change = torch.cat([self.rotations.turns(sight.trial), change])
            gradient, precision = self.rotations.derivatives(sight.trial, change)
            inside = self._inside(sight.shift)
            gradient, precision = inside * gradient, inside * precision
            gradient[-1] += 2 * self._seen_rim * self._told(sight.trial) * float(torch.exp(2 * sight.shift[2]))
            return gradient - place(sight) / sigma**2, precision + torch.diag(sigma**-2)

        def moved(sight: Sight, step: Tensor) -> Sight:
            shift = sight.shift + step[-3:]
            if not turning:
                return self.moved(sight, shift)
            return self.sight(rotation_of(step[:3]) @ sight.trial.rotation, shift)

        pace = (1.0, MOST_STEPS) if turning else (_LONGEST_STRETCH, _MOST_STEPS)
        top = ascend(start, height, slope, moved, *pace)
        volume = -0.5 * float(torch.logdet(top.precision)) - float(sigma.log().sum())
        turn_prior = top.height - top.best.log_evidence - self.log_prior(top.best.shift)
        return SightSummit(top.best, top.precision, top.height, turn_prior, top.height + volume, top.converged)

    def log_prior(self, shift: Tensor) -> float:
        """Log density of a shift before the shading is seen, less that of the likeliest."""
        return -0.5 * float(((shift - self._expected) / self._sigma).square().sum())

    def climb_alone(self, start: Sight) -> SightSummit:
        """`climb` of the silhouette alone: from the outline that is seen.

        Where none is, from where edges are smeared, which stop it nowhere, to where it is.
        """
        if self.edge is not None:
            return self.climb(self.moved(start, self._expected), False)
        blunt = SilhouetteSearch(self.rotations, self.moving.smeared(_BLUNT))
        rough = blunt.climb(blunt.moved(start, start.shift), False)
        return self.climb(self.moved(start, rough.sight.shift), False)

    def _y(self, shift: Tensor) -> Tensor:
        return self.moving.seen(shift)[None].to(self.rotations.y)

    def of(self, trial: Trial, shift: Tensor) -> Sight:
        """A trial of the photograph with one silhouette."""
        if self._outside is None:
            self._outside = self._as_unknown(trial)
        return Sight(trial, shift, trial.log_evidence + (self._inside(shift) - 1) * self._told(trial))

    def _inside(self, shift: Tensor) -> float:
        """Pixels of the photograph inside, in parts of those of the guess; 1 where none of the rim can be used."""
        return 1 + self._seen_rim * float(torch.expm1(2 * shift[2]))

    def _told(self, trial: Trial) -> float:
        """Log evidence that a material explains what is inside, rather than nothing."""
        assert self._outside is not None
        return max(0.0, trial.log_evidence - self._outside)

    def _as_unknown(self, trial: Trial) -> float:
        """Log evidence of the pixels, were their radiance unknown."""
        space = trial.explanation.bank.space
        _, energy = space.project(trial.y)
        square = UNKNOWN**2 * energy[0]
        if bool(self._rim.any()):
            inside, outside = (self._y(torch.tensor([0.0, 0.0, g], dtype=torch.float64))[0] for g in (-REACH, REACH))
            across = ((outside - inside) * space.inverse)[:, self._rim].square().mean(-1)
            square = torch.minimum(square, trial.y.shape[-1] * across)
        lit = energy[0] > 0
        return -0.5 * self.rotations.weight * float(square[lit].clamp_min(_LEAST).log().sum())


def _rim(mask: Tensor) -> Tensor:
    """(P,) bool: the pixels of a view at its silhouette."""
    n = mask.shape[-1]
    middles = (torch.arange(n, dtype=torch.float64) + 0.5) * (2 / n) - 1
    distance = torch.hypot(middles, middles[:, None])[mask[0]]
    return distance >= distance.quantile(1 - _RIM)
