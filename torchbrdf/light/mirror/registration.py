"""How the camera of a second photograph is turned against the first: from what both show of one light."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import degrees, pi, sqrt

import numpy as np
import torch
from torch import Tensor

from torchbrdf.images import luminance
from torchbrdf.light.latlong import bilinear, resize
from torchbrdf.light.mirror.unwrapping import Seen
from torchbrdf.light.rotations import rotation_angle, rotation_of

_FLOOR = 0.01
"""Of the mean luminance, which is added before the logarithm: darker than that is noise."""

_TURNS = 6000
"""Tried at first, about 15 degrees apart, on maps of _FIRST rows."""

_FIRST, _TRIED = 16, 400
_LEVELS = ((32, 12, 1000), (64, 4, 3000), (128, 2, 6000), (256, 1, 12000))
"""Rows of the maps, how many of the best turns go on to them, and the directions compared."""

_REGIONS = 200
"""Of the sphere, in which the exposures of both are compared."""

_STEPS = 6
_OUTLIER = 2.0
"""Deviations, in their own median, at which a direction counts half: near things look different from another side."""

_APART = 0.35
"""Radians between turns that are different ones."""

_LEAST_CORRELATION, _LEAST_LEAD = 0.75, 0.03

_SAME_GAIN = 0.05
"""Exposures that differ by less are taken for the same: what is near looks different, too."""


@dataclass(frozen=True)
class Registration:
    """What the comparison found.

    rotation     (3, 3) float64: a direction d in the second camera's frame is R d in the first's
    gain         how many times as bright the second is; 1 where the difference is too small to be an exposure
    correlation  of the logarithms of both, in 1 or below
    residual     their robust difference, relative
    """

    rotation: Tensor
    gain: float
    correlation: float
    residual: float

    @property
    def degrees(self) -> float:
        """By which the second camera is turned."""
        return degrees(rotation_angle(self.rotation))

    def __str__(self) -> str:
        """For people."""
        return (
            f"the second camera is turned by {self.degrees:.2f} degrees; what both show differs by {self.residual:.1%}"
            f" (correlation {self.correlation:.3f})"
        )


def find_rotation(first: Seen, second: Seen) -> Registration:
    """Compare the logarithms of what two cameras see, each in its own frame, under all rotations, coarse to fine.

    Raises ValueError where no rotation makes them agree, or two different ones do equally.
    """
    turns = _even_turns(_TURNS)
    coarse = _Pair.of(first, second, _FIRST, _TRIED)
    scores = torch.cat([coarse.correlation(some) for some in turns.split(500)])
    turns = turns[scores.argsort(descending=True)]
    rival = -1.0
    for height, most, count in _LEVELS:
        pair = _Pair.of(first, second, height, count)
        turns = _distinct(turns, most)
        turns = torch.stack([pair.refined(turn) for turn in turns])
        scores = pair.correlation(turns)
        order = scores.argsort(descending=True)
        turns, scores = turns[order], scores[order]
        away = _angles(turns[0], turns) > _APART
        if most > 1:
            rival = float(scores[away].max()) if bool(away.any()) else -1.0
    correlation = float(scores[0])
    if not correlation >= _LEAST_CORRELATION:
        raise ValueError(
            f"the two photographs do not show one light: turned at best, their correlation is {correlation:.2f} (below "
            f"{_LEAST_CORRELATION:g}); photograph the same ball in the same place and light"
        )
    if correlation - rival < _LEAST_LEAD:
        raise ValueError(
            "the two photographs fit each other equally well in two ways: the light is too uniform to tell how the "
            "camera was turned; give one photograph"
        )
    gain = pair.gain(turns[0])
    return Registration(turns[0], gain if abs(gain - 1) > _SAME_GAIN else 1.0, correlation, pair.residual(turns[0]))


@dataclass(frozen=True)
class _Pair:
    """Maps (2, H, 2 H) of both: the logarithm of the mean luminance times how sharply it is seen, and the latter.

    directions  (N, 3), even over the sphere
    """

    first: Tensor
    second: Tensor
    directions: Tensor

    @classmethod
    def of(cls, first: Seen, second: Seen, height: int, count: int) -> _Pair:
        """At so many rows."""
        return cls(_logarithm(first, height), _logarithm(second, height), _even_directions(count))

    def values(self, turns: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Of the first (N,), of the second under rotations (T, 3, 3), (T, N), and how sharply both are seen (T, N)."""
        values, sharpness = self._of_first
        other = bilinear(self.second, self.directions @ turns.to(self.directions))
        return values, other[..., 0] / other[..., 1].clamp_min(1e-3), sharpness * other[..., 1]

    @cached_property
    def _of_first(self) -> tuple[Tensor, Tensor]:
        seen = bilinear(self.first, self.directions)
        return seen[:, 0] / seen[:, 1].clamp_min(1e-3), seen[:, 1]

    def correlation(self, turns: Tensor) -> Tensor:
        """(T,): weighted by how sharply both are seen."""
        a, b, weights = self.values(turns)
        weights = weights / weights.sum(-1, keepdim=True).clamp_min(1e-6)
        a, b = (each - (each * weights).sum(-1, keepdim=True) for each in (a.expand_as(b), b))
        covariance, first, second = ((x * y * weights).sum(-1) for x, y in ((a, b), (a, a), (b, b)))
        return covariance / (first * second).clamp_min(1e-12).sqrt()

    def refined(self, turn: Tensor) -> Tensor:
        """By Gauss-Newton steps on robust differences."""
        step = pi / self.first.shape[1] / 2
        axes = torch.eye(3, dtype=torch.float64)
        nudges = torch.stack([rotation_of(s * step * axis) for axis in axes for s in (1, -1)])
        for _ in range(_STEPS):
            off, weights = self._robust(turn)
            _, moved, _ = self.values(nudges @ turn)
            slope = (moved[0::2] - moved[1::2]).T.double() / (2 * step)
            slope = torch.cat([slope, torch.ones_like(slope[:, :1])], 1)
            system = slope.T @ (weights[:, None] * slope) + 1e-9 * torch.eye(4, dtype=torch.float64)
            change = torch.linalg.solve(system, slope.T @ (weights * off))[:3]
            change = change * (4 * step / change.norm().clamp_min(4 * step))
            turn = rotation_of(change) @ turn
            if float(change.norm()) < 1e-3 * step:
                break
        return turn

    def gain(self, turn: Tensor) -> float:
        """How many times as bright the second is, in the median of regions, by their light.

        Sharpness differs between the two: the means of regions tell the exposure, not their details, nor dark regions
        beside bright ones.
        """
        a, b, weights = (each.double() for each in self.values(turn[None]))
        region = (self.directions @ _even_directions(_REGIONS).T).argmax(1)
        weight, first, second = (
            torch.zeros(_REGIONS, dtype=torch.float64).index_add_(0, region, each * weights[0])
            for each in (torch.ones_like(a), a.exp(), b[0].exp())
        )
        known = weight >= weight.max() / 2
        ratio, order = (second[known] / first[known]).sort()
        share = (first * second).sqrt()[known][order].cumsum(0)
        return float(ratio[torch.searchsorted(share, share[-1] / 2)])

    def residual(self, turn: Tensor) -> float:
        """The robust relative difference, whatever the exposure."""
        off, weights = self._robust(turn)
        mean = (off * weights).sum() / weights.sum()
        return float((((off - mean) ** 2 * weights).sum() / weights.sum()).sqrt())

    def _robust(self, turn: Tensor) -> tuple[Tensor, Tensor]:
        """First minus second (N,), and weights (N,) that are small where that is far from usual."""
        a, b, weights = (each.double() for each in self.values(turn[None]))
        off, weights = a - b[0], weights[0]
        best = weights >= weights.max() / 2
        centre = off[best].median()
        usual = (off - centre).abs()[best].median().clamp_min(1e-4)
        return off, weights / (1 + ((off - centre) / (_OUTLIER * usual)) ** 2)


def _logarithm(seen: Seen, height: int) -> Tensor:
    bright = luminance(seen.radiance)
    means, known = resize(torch.stack([bright * seen.weight, seen.weight]), height)
    mean = bright[seen.known].mean()
    return torch.stack([(means / known.clamp_min(1e-3) + _FLOOR * mean).log() * known, known])


def _even_directions(count: int) -> Tensor:
    """(N, 3) float32, along a spiral by the golden angle."""
    i = torch.arange(count, dtype=torch.float64) + 0.5
    y = 1 - 2 * i / count
    phi = i * (pi * (3 - sqrt(5)))
    across = (1 - y * y).sqrt()
    return torch.stack([across * phi.sin(), y, -across * phi.cos()], -1).float()


def _even_turns(count: int) -> Tensor:
    """(T, 3, 3) float64: rotations spread evenly, along a spiral on the unit quaternions [Ale22]."""
    from scipy.spatial.transform import Rotation  # here, because it is slow to import

    s = np.arange(count) + 0.5
    r, small = np.sqrt(s / count), np.sqrt(1 - s / count)
    alpha, beta = 2 * np.pi * s / np.sqrt(2), 2 * np.pi * s / 1.533751168755204288118041
    quaternions = np.stack([r * np.sin(alpha), r * np.cos(alpha), small * np.sin(beta), small * np.cos(beta)], -1)
    return torch.from_numpy(Rotation.from_quat(quaternions).as_matrix())


def _angles(turn: Tensor, others: Tensor) -> Tensor:
    """(T,) radians between rotations."""
    traces = (turn * others).sum((-1, -2))
    return ((traces - 1) / 2).clamp(-1, 1).acos()


def _distinct(turns: Tensor, most: int) -> Tensor:
    """The first of those that are nearly the same, at most so many."""
    kept: list[Tensor] = []
    for turn in turns:
        if all(float(_angles(turn, other[None])) > _APART / 4 for other in kept):
            kept.append(turn)
        if len(kept) == most:
            break
    return torch.stack(kept)
