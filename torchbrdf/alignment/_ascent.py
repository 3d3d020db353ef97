"""Gauss-Newton steps uphill, of whatever has slopes and curvatures."""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, radians
from typing import Generic, TypeVar

import torch
from torch import Tensor

_LONGEST_STEP = radians(8)
SMALLEST_STEP = radians(0.01)
_FIRST_DAMPING = 0.5
_MOST_DAMPING = 100.0

_HOPE = 4.0
"""Times what the derivatives promise that a climb may gain."""

Place = TypeVar("Place")
"""Where a climb may stand."""


@dataclass(frozen=True, eq=False)
class Top(Generic[Place]):
    """Where steps uphill ended: the best place, its height, the precision there, and whether the last step was short.

    It was not where steps ran out, or none of any length led higher.
    hope  what the climb might gain as its start promised
    step  (K,): the last, where it was short, not taken
    """

    best: Place
    height: float
    precision: Tensor
    converged: bool
    hope: float
    step: Tensor


def ascend(
    start: Place,
    height: Callable[[Place], float],
    slope: Callable[[Place], tuple[Tensor, Tensor]],
    moved: Callable[[Place, Tensor], Place],
    longest_stretch: float,
    most_steps: int,
    shortest: float = SMALLEST_STEP,
    negligible: float = 0.0,
    ends: Callable[[Place, float], bool] = lambda place, gain: False,
) -> Top[Place]:
    """Gauss-Newton steps uphill, shorter ones where they led down, longer ones while they lead up.

    slope            first (K,) and minus second derivatives (K, K)
    moved            a place and a step (K,), in radians or radii, to another place
    longest_stretch  of steps: where the second derivatives are those of edges, they are too large between them
    shortest         step, in the same units
    negligible       squared standard deviations from the top, by the derivatives, that end the climb
    ends             whether a place does that may gain so much; infinitely much before its derivatives are known
    """
    best, top, damping, stretch = start, height(start), 0.0, 1.0
    precision, hope, step = torch.empty(0), None, torch.zeros(0)
    for _ in range(most_steps):
        gradient, precision = slope(best)
        deviations = float(gradient @ torch.linalg.solve(precision, gradient))
        gain = _HOPE * deviations / 2
        hope = gain if hope is None else hope
        if deviations < negligible or ends(best, gain):
            return Top(best, top, precision, deviations < negligible, hope, torch.zeros_like(gradient))
        while True:
            step = torch.linalg.solve(precision + damping * torch.diag(precision.diagonal()), gradient)
            step = step * min(stretch, _LONGEST_STEP / max(float(step.norm()), 1e-12))
            short = float(step.norm()) < shortest
            if short or damping > _MOST_DAMPING:
                return Top(best, top, precision, short, hope, step if short else torch.zeros_like(step))
            new = moved(best, step)
            reached = height(new)
            if reached > top:
                break
            damping = max(_FIRST_DAMPING, 4 * damping) if stretch == 1 else damping
            stretch = 1.0
        best, top, damping, stretch = new, reached, damping / 4, min(2 * stretch, longest_stretch)
        if ends(best, inf):
            break
    return Top(best, top, precision, False, hope or 0.0, torch.zeros_like(step))
