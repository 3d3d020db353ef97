"""The silhouette of a ball under which a photograph is explained best, together with the rotation of its light.

Half a pixel of silhouette costs as much as a degree of the probe. The evidence that finds the one finds the other.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import log
from operator import attrgetter

import torch
from torch import Tensor

from torchbrdf.alignment._search import RotationSearch, Summit, Trial
from torchbrdf.alignment._silhouette_search import EXPECTED, TOO_SURE, Sight, SightSummit, SilhouetteSearch
from torchbrdf.camera import Ball
from torchbrdf.images import Window
from torchbrdf.photograph import Circle, MovingSilhouette, Observation, observe
from torchbrdf.view import SphereView, View

CLEAR = log(10)
"""Log odds above which a probe is turned."""

MOVED = 3.0
"""Log density that another silhouette must have beyond the guess, which is never right to the last digit: so its place
is not weighed against all others."""

_PREFERRED = 1.0
"""Log density by which another silhouette is better, whatever a turn could explain, for `covariance` to tell of it."""

_LEAST_TOO_SURE, _MOST_TOO_SURE = (float(each) for each in (TOO_SURE.min() ** 2, TOO_SURE.max() ** 2))
"""What differences of evidence are divided by."""

_DECIDED = 10.0
"""Log odds above which a silhouette is moved whatever a turn alone could explain."""


@dataclass(frozen=True, eq=False)
class FoundSilhouette:
    """The silhouette of a ball, and what the photograph shows inside it.

    silhouette   as found; the guess where no other is clearly better
    guess        that was given
    covariance   (3, 3) float64 of x, y and radius, in pixels of the photograph, squared: what the photograph leaves
                 open, and the way to what it would prefer where that is not clearly better
    log_gain     by how much the logarithm of the posterior density is higher than that of the guess; the silhouette is
                 moved where that is more than MOVED
    observation  the photograph resampled to the pixels of the view
    view         of the silhouette; that of a ball has its direction and size
    """

    silhouette: Circle | Ball
    guess: Circle | Ball
    covariance: Tensor
    log_gain: float
    observation: Observation
    view: View

    def turn_from(self, view: View) -> Tensor:
        """(3, 3): by which a light turns that is to look from this view as it did from another of the same camera."""
        if not isinstance(view, SphereView) or not isinstance(self.view, SphereView):
            return torch.eye(3, dtype=torch.float64)
        return self.view.rotation @ view.rotation.T

    @property
    def moved(self) -> bool:
        """Whether the guess was off."""
        return self.silhouette is not self.guess

    @property
    def std(self) -> tuple[float, float, float]:
        """Standard deviations of x, y and radius, in pixels of the photograph."""
        x, y, radius = self.covariance.diagonal().sqrt().tolist()
        return x, y, radius

    def __str__(self) -> str:
        """One line on what was found."""
        x, y, radius = self.std
        certainty = f"standard deviations {x:.2f}, {y:.2f} and {radius:.2f} pixels"
        if not self.moved:
            return f"silhouette left as it is: no other explains the photograph clearly better ({certainty})"
        before, after = self.guess.circle, self.silhouette.circle
        right, down, grown = (b - a for a, b in zip(before, after, strict=True))
        return (
            f"silhouette moved by ({right:+.2f}, {down:+.2f}) and its radius by {grown:+.2f} pixels to the "
            f"{self.silhouette} ({certainty})"
        )


def guessed(image: Tensor, mask: Tensor | None, view: View, silhouette: Circle | Ball | bool) -> Circle | Ball:
    """The first guess: what is given, or the circle that a square photograph inscribes.

    Raises ValueError for a photograph, mask or view that is none, is not square where no guess is given, or is not by
    a camera that sees a ball.
    """
    if not isinstance(view, SphereView):
        raise ValueError(f"a silhouette can be found of a ball: the view must be a SphereView, got {view!r}")
    if image.ndim != 3 or image.shape[0] != 3 or not image.is_floating_point():
        raise ValueError(f"image must be linear radiance (3, H, W), got {image.dtype} {tuple(image.shape)}")
    height, width = image.shape[1:]
    if mask is not None and (mask.dtype != torch.bool or mask.shape != (1, height, width)):
        raise ValueError(f"mask must be bool {(1, height, width)}, got {mask.dtype} {tuple(mask.shape)}")
    if isinstance(silhouette, Ball) and view.fov_deg is None:
        raise ValueError(
            f"a Ball is seen in perspective, and {view!r} is not; give SphereView.of_ball({view.size[0]}, ball), or "
            "its Circle"
        )
    if not isinstance(silhouette, bool):
        return silhouette
    if height != width:
        raise ValueError(
            f"the photograph is {height} x {width}, and silhouette=True takes a square crop around the ball; give its "
            "circle, as a first guess: silhouette=Circle(x, y, radius)"
        )
    return Circle.inscribed(Window(0, 0, width, height))


@dataclass(frozen=True, eq=False)
class Joint:
    """Rotation and silhouette, as found together.

    believed    the rotation that was believed, with the silhouette that was chosen
    summit      of rotations with that silhouette, with what it leaves open about them
    shift       (3,) of the silhouette; None where the guess is kept
    covariance  (3, 3) float64 of shifts, see `FoundSilhouette`
    log_gain    see `FoundSilhouette`
    """

    believed: Trial
    summit: Summit
    shift: Tensor | None
    covariance: Tensor
    log_gain: float

    @property
    def shown(self) -> Tensor:
        """(1, 3, P): the photograph with the silhouette that was chosen."""
        return self.believed.y

    def silhouette(self, moving: MovingSilhouette, image: Tensor, mask: Tensor | None, view: View) -> FoundSilhouette:
        """What is told of it, with the photograph resampled to the pixels of its view."""
        guess = moving.guess
        found = guess if self.shift is None else moving.at(self.shift)
        radius = found.circle[2]
        to_pixels = torch.diag(torch.tensor([radius, -radius, radius], dtype=torch.float64))
        n = view.size[0]
        return FoundSilhouette(
            silhouette=found,
            guess=guess,
            covariance=to_pixels @ self.covariance @ to_pixels,
            log_gain=self.log_gain,
            observation=observe(image, found, mask, n),
            view=SphereView.of_ball(n, found) if isinstance(found, Ball) and self.shift is not None else view,
        )


def find(
    rotations: RotationSearch, moving: MovingSilhouette, believed: Trial, starts: Sequence[Trial], turn_costs: float
) -> Joint:
    """Climb from every start, with the silhouette alone, and then together with the rotation; weigh both.

    believed    the rotation that is believed, with the guess
    turn_costs  log odds that a rotation must have beyond CLEAR, for how many were tried
    """
    none = torch.zeros(3, dtype=torch.float64)
    search, kept, alone = _alone(rotations, moving, believed)
    begun = [alone if start is believed else search.climb_alone(search.of(start, none)) for start in starts]
    together = max((search.climb(one.sight, True) for one in begun), key=attrgetter("log_evidence"))
    costs = CLEAR + turn_costs
    told, turned = _left_open(together)
    away = together.sight.shift
    surely = 0.5 * float(away @ torch.linalg.solve(told, away))
    any_shift = alone.log_evidence - alone.height
    best_moved = max(alone.log_evidence, together.log_evidence - costs) - any_shift
    at_guess = search.log_prior(none)
    log_gain = min(
        (best_moved - kept.log_evidence - at_guess) / _LEAST_TOO_SURE, surely, _moved_rather_than_not(away, told)
    )
    still = None
    if search.edge is not None and log_gain <= MOVED:  # the guess lies where the outline is seen
        still = _at_the_guess(search, together, turned)
    elif log_gain < _DECIDED:
        still = max((rotations.climb(start) for start in starts), key=attrgetter("log_evidence"))
        otherwise = max(kept.log_evidence, still.log_evidence - costs) + at_guess
        log_gain = min((best_moved - otherwise) / _LEAST_TOO_SURE, surely)
    if still is None or log_gain > MOVED:
        gained = together.log_evidence - alone.log_evidence
        chosen = together.sight if gained > costs else alone.sight
        trial = alone.sight.trial if chosen is alone.sight else search.moved(kept, chosen.shift).trial
        summit = Summit(together.sight.trial, turned, trial.log_evidence + gained, together.converged)
        return Joint(trial, summit, chosen.shift, told, log_gain)
    if surely >= _PREFERRED:
        told = told + torch.outer(away, away)
    summit = Summit(still.trial, turned, still.log_evidence, still.converged and together.converged)
    return Joint(believed, summit, None, told, log_gain)


def _alone(
    rotations: RotationSearch, moving: MovingSilhouette, believed: Trial
) -> tuple[SilhouetteSearch, Sight, SightSummit]:
    """The search, what is believed, and the best silhouette under that rotation.

    An outline that is seen is another's where shading tells clearly that the guess is better.
    """
    none = torch.zeros(3, dtype=torch.float64)
    if moving.edge is not None:
        search = SilhouetteSearch(rotations, moving, moving.edge)
        kept = search.of(believed, none)
        alone = search.climb_alone(kept)
        if kept.log_evidence - alone.sight.log_evidence < MOVED * _MOST_TOO_SURE:
            return search, kept, alone
    search = SilhouetteSearch(rotations, moving)
    kept = search.of(believed, none)
    return search, kept, search.climb_alone(kept)


def _at_the_guess(search: SilhouetteSearch, together: SightSummit, turned: Tensor) -> Summit:
    """The summit of rotations with the guess, where that is hardly off: the light is turned as with the best."""
    trial = search.moved(together.sight, torch.zeros(3, dtype=torch.float64)).trial
    volume = -0.5 * float(torch.logdet(turned)) - 3 * log(search.rotations.expected)
    return Summit(trial, turned, trial.log_evidence + together.turn_prior + volume, together.converged)


def _left_open(together: SightSummit) -> tuple[Tensor, Tensor]:
    """The covariance (3, 3) of shifts, of which evidence is too sure, and the precision (3, 3) of turns with those."""
    covariance = torch.linalg.inv(together.precision)
    shifts = covariance[3:, 3:]
    told = shifts * torch.outer(TOO_SURE, TOO_SURE)
    imitated = torch.linalg.solve(shifts, covariance[3:, :3])
    return told, torch.linalg.inv(covariance[:3, :3] + imitated.T @ (told - shifts) @ imitated)


def _moved_rather_than_not(shift: Tensor, covariance: Tensor) -> float:
    """Log odds of a silhouette moved by anything against none, with any rotation [Savage-Dickey]."""
    there = -0.5 * float(shift @ torch.linalg.solve(covariance, shift) + torch.logdet(covariance))
    return -3 * log(EXPECTED) - there
