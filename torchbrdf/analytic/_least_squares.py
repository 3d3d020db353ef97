"""Bounded least squares over the parameters of an analytic BRDF, by SciPy's trust-region reflective method [BCL99]."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from torchbrdf.analytic.shading_geometry import ShadingGeometry
from torchbrdf.analytic.variables import FitVariables

_TOLERANCE = 1e-7
"""Of the change of the loss and of the vector, relative."""

_INSIDE = 1e-4
"""A start lies at least this share of the range inside the bounds: the method cannot leave one."""

_SECOND_INSIDE = 0.2
"""That of a second search, which climbs out of the valleys in which a first may end (docs/analytic.md)."""


class Residuals(Protocol):
    """What is to become small: a function of f_r of N pairs of directions.

    geometry  of the pairs
    """

    @property
    def geometry(self) -> ShadingGeometry: ...

    def of(self, f_r: Tensor) -> Tensor:
        """(M, 3) of f_r (N, 3). Those of a channel depend on f_r of that channel only."""

    def along(self, f_r: Tensor, tangents: Tensor) -> Tensor:
        """(S, M, 3): derivatives of `of` at f_r along tangents (S, N, 3)."""


@dataclass(frozen=True)
class Progress:
    """The best loss after so many evaluations of the model and seconds."""

    evaluations: int
    seconds: float
    loss: float


@dataclass(frozen=True, eq=False)
class Minimum:
    """Where a search ended.

    x            (V,)
    loss         sum of the squares of the residuals
    converged    the method met its tolerance
    iterations   accepted steps, and the first point; evaluations: of the residuals
    seconds      it took
    history      whenever the loss fell
    """

    x: np.ndarray
    loss: float
    converged: bool
    iterations: int
    evaluations: int
    seconds: float
    history: tuple[Progress, ...]


def minimise(
    variables: FitVariables, start: np.ndarray, residuals: Residuals, most_evaluations: int, inside: float = _INSIDE
) -> Minimum:
    """The least sum of squares from one start (V,) within the bounds, with at most so many evaluations.

    inside  the start is first moved so far inside the bounds, as a share of the range
    """
    from scipy.optimize import least_squares

    began, history = time.perf_counter(), []
    evaluations, best = 0, np.inf

    def values(x: np.ndarray) -> np.ndarray:
        nonlocal evaluations, best
        found = residuals.of(variables.evaluate(torch.from_numpy(x), residuals.geometry)).double().numpy().ravel()
        evaluations, loss = evaluations + 1, float(found @ found)
        if loss < best:
            best = loss
            history.append(Progress(evaluations, time.perf_counter() - began, loss))
        return found

    def jacobian(x: np.ndarray) -> np.ndarray:
        at = variables.linearise(x, residuals.geometry)
        return variables.jacobian(residuals.along(at.f_r, at.tangents), at.signs)

    lower, upper = variables.bounds
    margin = inside * (upper - lower)
    solved = least_squares(
        values,
        np.clip(start, lower + margin, upper - margin),
        jacobian,
        (lower, upper),
        x_scale="jac",
        ftol=_TOLERANCE,
        xtol=_TOLERANCE,
        gtol=None,
        max_nfev=most_evaluations,
    )
    return Minimum(
        solved.x,
        float(2 * solved.cost),
        bool(solved.status > 0),
        int(solved.njev),
        evaluations,
        time.perf_counter() - began,
        tuple(history),
    )


def climb_out(variables: FitVariables, found: Minimum, residuals: Residuals, most_evaluations: int) -> Minimum:
    """The better of a minimum and of a second search from it, moved inside the bounds; it counts both.

    most_evaluations  of both together
    """
    left = most_evaluations - found.evaluations
    second = minimise(variables, found.x, residuals, left, _SECOND_INSIDE)
    least = (1 - _TOLERANCE) * found.loss
    later = [
        Progress(found.evaluations + one.evaluations, found.seconds + one.seconds, one.loss)
        for one in second.history
        if one.loss < least
    ]
    return replace(
        second if second.loss < least else found,
        iterations=found.iterations + second.iterations,
        evaluations=found.evaluations + second.evaluations,
        seconds=found.seconds + second.seconds,
        history=(*found.history, *later),
    )


def best_of(minima: Sequence[Minimum]) -> Minimum:
    """The least of several."""
    return min(minima, key=lambda minimum: minimum.loss)
