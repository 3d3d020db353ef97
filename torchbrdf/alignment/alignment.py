"""The rotation of a light probe that explains a photograph best.

A probe captured beside the object is never turned exactly as the object saw it, and one degree spoils a reconstruction
[CBP21, table I]. `align` finds the rotation from the photograph itself, and says what the photograph leaves open.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import degrees, inf, log, pi, radians
from typing import get_args

import torch
from torch import Tensor

from torchbrdf.alignment._search import RIVAL, RotationSearch, Summit, Trial, best_of
from torchbrdf.alignment.exposure import Exposure, exposure_of
from torchbrdf.alignment.lamps import LampRadiance, first_guess, with_lamp
from torchbrdf.alignment.settings import Range
from torchbrdf.alignment.silhouette import CLEAR, FoundSilhouette, find, guessed
from torchbrdf.brdf import MaterialLibrary
from torchbrdf.camera import Ball
from torchbrdf.estimation import check_observation
from torchbrdf.images import luminance
from torchbrdf.lasting import without_autocast
from torchbrdf.light import LightProbe, checked_rotation, rotation_angle, rotation_of, rotation_vector
from torchbrdf.photograph import Circle, MovingSilhouette, Observation, observe
from torchbrdf.transport import BasisImages
from torchbrdf.transport.harmonic import NEAREST, HarmonicBasis, unsuited
from torchbrdf.view import Frames, SphereView, View

EXPECTED = radians(5)
"""Standard deviation, about each axis, of how far a probe is turned before the photograph is seen."""

CONFIDENT = radians(1)
"""Standard deviation about the least certain axis up to which a photograph tells the rotation."""

_SEARCHED = 64
"""Pixels across a ball that are searched, where its photograph can be resampled: more tell of what no library holds."""

_PREFERRED = 1.0
"""Log evidence by which a turn is better for `covariance` to tell of it."""

_TURNS = 24
"""Rotations about the vertical axis that the full search compares."""

_FOLLOWED = 2
"""How many of them are climbed from at most."""

_ROUGHLY = radians(0.5)
"""Last step of a climb with few materials: from its end all of them are climbed with."""

_LAMPS_SIZE, _DOMINANT = 0.001, 0.2
"""Shares of the sphere and of the light: lamps that may make side peaks. A sun in the clear has a quarter and more."""

_BLURS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Degrees that are tried, each only while the evidence grows."""

_BLUR_REFINEMENTS = 2
_WORTH_A_BLUR = 3.0
"""Log evidence that a blur has to gain."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """How a light probe must be turned to explain a photograph.

    rotation      (3, 3) float64: radiance that came from d now comes from R d. That of the start where no other is
                  clearly better: see log_odds
    source        the probe as it was given, its lamps brightened and all of it blurred where that was found
    basis         basis images under `probe`, for `BRDFEstimator`: made by turning directions, sharper than from `probe`
    covariance    (3, 3) float64, radians^2, of a further turn about +X, +Y and +Z: what the photograph leaves open, and
                  the turn that it would prefer where that is not clearly better
    log_odds      natural logarithm of the odds that the probe had to be turned rather than was right at the start
    blur          degrees, standard deviation of the blur of the probe; 0 without
    exposure      what the photograph has to be divided by; None unless asked for
    converged     whether the search ended by itself
    evaluations   how many rotations were looked at
    lamp          what was found of lamps at which the probe may be clipped, see `LightProbe.lamps`; None without
    ball          its silhouette, found together with the rotation, and the observation inside it; None unless asked for
    """

    rotation: Tensor
    source: LightProbe
    basis: BasisImages
    covariance: Tensor
    log_odds: float
    blur: float
    exposure: Exposure | None
    converged: bool
    evaluations: int
    lamp: LampRadiance | None = None
    ball: FoundSilhouette | None = None

    @property
    def silhouette(self) -> Circle | Ball | None:
        """Of the ball, as found; the guess where no other is clearly better, None unless asked for."""
        return None if self.ball is None else self.ball.silhouette

    @property
    def observation(self) -> Observation | None:
        """The photograph resampled with that silhouette, to fit with; None unless it was asked for."""
        return None if self.ball is None else self.ball.observation

    @cached_property
    def probe(self) -> LightProbe:
        """The probe turned, and blurred where that was found; resampled."""
        return self.source.rotated(self.rotation)

    @property
    def angle(self) -> float:
        """Degrees by which the probe is turned."""
        return degrees(rotation_angle(self.rotation))

    @property
    def uncertainty(self) -> float:
        """Standard deviation in degrees about the axis about which the photograph tells least."""
        return degrees(float(torch.linalg.eigvalsh(self.covariance)[-1].sqrt()))

    @property
    def confident(self) -> bool:
        """Whether the photograph tells the rotation about every axis to a degree."""
        return self.converged and self.uncertainty <= degrees(CONFIDENT)

    @property
    def turned(self) -> bool:
        """Whether another rotation than that of the start explains the photograph clearly better, and was taken."""
        return self.log_odds > CLEAR

    def __str__(self) -> str:
        """One line on what was found."""
        axis = rotation_vector(self.rotation)
        x, y, z = (axis / axis.norm().clamp_min(1e-12)).tolist()
        what = f"turned by {self.angle:.2f} degrees about ({x:.2f}, {y:.2f}, {z:.2f})"
        if not self.turned:
            kept = f"kept {what}, as believed: no other" if self.angle else "left as it is: no"
            what = f"{kept} turn explains the photograph clearly better"
        certainty = f"standard deviation {self.uncertainty:.2f} degrees about the least certain axis"
        warning = "" if self.confident else ", more than this photograph can tell for sure"
        blurred = f", blurred by {self.blur:.2f} degrees" if self.blur else ""
        exposed = f"; {self.exposure}" if self.exposure else ""
        seen = f"; {self.ball}" if self.ball else ""
        lit = f"; {self.lamp}" if self.lamp else ""
        return f"light probe {what}{blurred} ({certainty}{warning}){lit}{exposed}{seen}"


@without_autocast
def align(
    image: Tensor,
    probe: LightProbe,
    view: View,
    library: MaterialLibrary,
    *,
    mask: Tensor | None = None,
    search: Range = "near",
    start: Tensor | None = None,
    silhouette: Circle | Ball | bool = False,
    blur: bool = False,
    exposure: bool = False,
    white_balance: bool = False,
    progress: bool = False,
) -> Alignment:
    """Find the rotation of the probe under which the library explains a photograph best.

    image     (3, H, W) linear radiance, float32 or float64
    view      as `HarmonicBasis` takes it: a `SphereView`, in perspective too, or a `NormalMapView`
    mask      (1, H, W) bool, True = use; None for all pixels of the view
    search    "near": within about 20 degrees. "full": about the vertical axis +Y by any angle, and near that
    start     (3, 3): the rotation that is believed, and kept where no other is clearly better; None for none
    silhouette  find where the ball is in the photograph, too, from a first guess up to 3 % of its diameter off, as the
              view shows it: a circle, or a ball before the photograph's camera. Image and mask are then the
              photograph's, of any size, with as much around the ball as there is. True guesses the circle that a square
              photograph inscribes
    blur      find a blur of the probe too
    exposure, white_balance  find a factor of the photograph too, one for all channels or one for each; a photograph
              tells neither better than materials that look alike differ in albedo, see `Exposure.std`
    progress  show it while the library's harmonic transport is precomputed, once
    The posterior of rotations is the evidence of the estimator's priors times a Gaussian of EXPECTED around where a
    search starts. Where a photograph tells nothing about an axis, that keeps the probe as it is.
    Raises ValueError for another view, image or mask.
    """
    if search not in get_args(Range):
        raise ValueError(f"search must be one of {', '.join(get_args(Range))}, got {search!r}")
    reason = unsuited(view)
    if reason is not None:
        raise ValueError(f"align needs a ball from {NEAREST:g} radii on, or normals without shadows: {reason}")
    moving, searched = None, view
    if silhouette is not False:
        guess = guessed(image, mask, view, silhouette)
        observe(image, guess, mask, view.size[0])  # raises where there is nothing to see
        if isinstance(view, SphereView) and view.size[0] > _SEARCHED:
            searched = SphereView(_SEARCHED, fov_deg=view.fov_deg, direction=view.direction)
        moving = MovingSilhouette(image, guess, mask, searched.size[0])
        y, used = moving.seen(torch.zeros(3, dtype=torch.float64))[None], moving.used
    else:
        y, used = _packed(image, mask, view)
    light = HarmonicBasis(library, probe, searched, progress)
    task = RotationSearch(light, y.to(light.transport.device, torch.float64), used, EXPECTED)
    rotation = torch.eye(3, dtype=torch.float64) if start is None else checked_rotation(start)
    believed = task.trial(rotation) if moving is None else task.trial(rotation, every=True)
    joint = None
    if moving is not None:
        starts = [start for start, _ in _starts(task, believed, search)]
        joint = find(task, moving, believed, starts, _turn_costs(search))
        believed, task = joint.believed, task.seeing(joint.shown)
    lamp = first_guess(task, believed)
    if lamp is not None:
        task, lamp, (summit, best, log_odds) = with_lamp(
            task, believed, lamp, lambda task, believed: _climbed(task, believed, search)
        )
    elif joint is not None:
        summit, best, log_odds = _weighed(joint.summit, believed, search)
    else:
        summit, best, log_odds = _climbed(task, believed, search)
    turned = log_odds > CLEAR
    sigma = 0.0
    if blur:
        best, sigma, summit = _blurred(task, best, summit, turned)
    away = rotation_vector(summit.trial.rotation @ best.rotation.T)
    if summit.trial.log_evidence - believed.log_evidence < _PREFERRED:
        away = torch.zeros(3, dtype=torch.float64)
    rotation, basis, source = best.rotation, best.basis, task.light.probe.blurred(sigma)
    ball = None if joint is None or moving is None else joint.silhouette(moving, image, mask, view)
    if ball is not None and ball.view is not searched:
        if turned and ball.view is not view:
            rotation = ball.turn_from(view) @ rotation
        basis = HarmonicBasis(library, source, ball.view).basis_at(rotation)
    return Alignment(
        rotation=rotation,
        source=source,
        basis=basis,
        covariance=torch.linalg.inv(summit.precision) + torch.outer(away, away),
        log_odds=log_odds,
        blur=sigma,
        exposure=exposure_of(task.y, best.explanation.bank.space, white_balance) if exposure or white_balance else None,
        converged=summit.converged,
        evaluations=task.evaluations,
        lamp=lamp,
        ball=ball,
    )


def _packed(image: Tensor, mask: Tensor | None, view: View) -> tuple[Tensor, Tensor]:
    """The pixels used of one photograph, (1, 3, P), and which those are of the view's."""
    y, used, batch = check_observation(image, mask, Frames((view.mask,)), False)
    if batch:
        raise ValueError(f"align takes one photograph (3, H, W), got a batch {tuple(batch)}; call it for each")
    return y[..., used[0]], used[0]


def _turn_costs(search: Range) -> float:
    """Log odds that a turn needs beyond CLEAR, for how many were tried."""
    return log(_TURNS if search == "full" else 1)


def _starts(task: RotationSearch, believed: Trial, search: Range) -> list[tuple[Trial, float]]:
    """Where climbs begin, and what each may gain."""
    if search == "full":
        return [(trial, inf) for trial in _turned_about_vertical(task, believed)]
    return _with_few(task, believed) if dominated(task.light.probe) else [(believed, inf)]


def dominated(probe: LightProbe) -> bool:
    """Whether so much light comes from so little of the sphere that the hill of rotations has side peaks."""
    bright = luminance(probe.radiance.detach().double()).flatten()
    angles = probe.solid_angles.flatten()
    order = bright.argsort(descending=True)
    of_lamps = angles[order].cumsum(0) <= _LAMPS_SIZE * 4 * pi
    power = (bright * angles)[order]
    return bool(power[of_lamps].sum() > _DOMINANT * power.sum())


def _with_few(task: RotationSearch, believed: Trial) -> list[tuple[Trial, float]]:
    """As `_starts`, also where few materials under less light end, whose hill has fewer side peaks, if higher."""
    coarse = task.coarse(believed)
    top = coarse.climb(coarse.trial(believed.rotation), _ROUGHLY)
    task.evaluations += coarse.evaluations
    found = task.trial(top.trial.rotation if top.ahead is None else top.ahead)
    if found.log_evidence > believed.log_evidence:
        return [(found, inf), (believed, top.hope)]
    return [(believed, inf)]


def _climbed(task: RotationSearch, believed: Trial, search: Range) -> tuple[Summit, Trial, float]:
    """The best summit, as `_weighed`."""

    def height(start: tuple[Trial, float]) -> float:
        return start[0].log_evidence

    (first, _), *others = sorted(_starts(task, believed, search), key=height, reverse=True)
    best = task.climb(first)
    beside = [task.climb_beside(start, best, hope) for start, hope in others]
    return _weighed(best_of([best, *filter(None, beside)]), believed, search)


def _weighed(summit: Summit, believed: Trial, search: Range) -> tuple[Summit, Trial, float]:
    """A summit; the trial there, or the one that is believed where it is not clearly better; the log odds."""
    log_odds = summit.log_evidence - believed.log_evidence - _turn_costs(search)
    return summit, summit.trial if log_odds > CLEAR else believed, log_odds


def _turned_about_vertical(task: RotationSearch, believed: Trial) -> list[Trial]:
    """Trials of the most promising turns about +Y, compared with few basis BRDFs and less light."""
    coarse = task.coarse(believed)
    up = torch.tensor([0, 1, 0], dtype=torch.float64)
    steps = [rotation_of(radians(360 / _TURNS * k) * up) for k in range(_TURNS)]
    turns = [step @ believed.rotation for step in steps]
    evidence = torch.tensor([trial.log_evidence for trial in coarse.trials(turns)], dtype=torch.float64)
    peak = (evidence >= evidence.roll(1)) & (evidence >= evidence.roll(-1))
    peak &= evidence > evidence.max() - RIVAL
    followed = torch.where(peak, evidence, -torch.inf).topk(min(_FOLLOWED, int(peak.sum()))).indices.tolist()
    task.evaluations += coarse.evaluations
    return [task.trial(turns[k]) for k in followed]


def _blurred(task: RotationSearch, best: Trial, summit: Summit, turned: bool) -> tuple[Trial, float, Summit]:
    """The blur that the photograph asks for, in degrees, with the rotation found again under it."""
    tried = {0.0: (task, best)}

    def evidence(sigma: float) -> float:
        if sigma not in tried:
            blurred = task.under(task.light.probe.blurred(sigma))
            tried[sigma] = blurred, blurred.trial(best.rotation)
        return tried[sigma][1].log_evidence

    for low, sigma in pairwise((0.0, *_BLURS)):
        if evidence(sigma) < evidence(low):
            break
    for _ in range(_BLUR_REFINEMENTS):  # between the neighbours of the best
        known = sorted(tried)
        at = known.index(max(tried, key=evidence))
        evidence((known[max(at - 1, 0)] + known[at]) / 2)
        evidence((known[at] + known[min(at + 1, len(known) - 1)]) / 2)
    sigma = max(tried, key=evidence)
    if evidence(sigma) - evidence(0.0) < _WORTH_A_BLUR:
        sigma = 0.0
    blurred, trial = tried[sigma]
    if sigma and turned:
        summit = blurred.climb(trial)
        trial = summit.trial
    task.evaluations += sum(one.evaluations for one, _ in tried.values() if one is not task)
    return trial, sigma, summit
