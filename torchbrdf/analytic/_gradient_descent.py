"""Gradient descent over the parameters of an analytic BRDF: Adam [KB15], as inverse rendering uses it."""

import time

import numpy as np
import torch

from torchbrdf.analytic._least_squares import Minimum, Progress, Residuals
from torchbrdf.analytic.variables import FitVariables

_RATE = 0.05
"""Step of the logit of each variable's place between its bounds."""

_PATIENCE = 40
_LEAST_GAIN = 1e-3
"""The search has converged where the best loss fell by less than this share within the last _PATIENCE steps."""

_INSIDE = 1e-3
"""A start lies at least this share of the range inside the bounds, where the logit is finite."""


def descend(variables: FitVariables, start: np.ndarray, residuals: Residuals, most_evaluations: int) -> Minimum:
    """The least sum of squares on the way of Adam from one start (V,) within the bounds."""
    lower, upper = map(torch.from_numpy, variables.bounds)
    share = ((torch.from_numpy(start) - lower) / (upper - lower)).clamp(_INSIDE, 1 - _INSIDE)
    logit = torch.logit(share).requires_grad_()
    optimiser = torch.optim.Adam([logit], lr=_RATE)
    geometry = residuals.geometry.to(torch.float32)  # as precise as a gradient need be, and faster
    began, history = time.perf_counter(), list[Progress]()
    best, losses = start, list[float]()
    converged = False
    for evaluations in range(1, most_evaluations + 1):
        with torch.enable_grad():
            x = lower + (upper - lower) * torch.sigmoid(logit)
            loss = residuals.of(variables.evaluate(x, geometry)).double().square().sum()
        if not history or loss.item() < history[-1].loss:
            history.append(Progress(evaluations, time.perf_counter() - began, loss.item()))
            best = x.detach().numpy().copy()
        losses.append(history[-1].loss)
        if evaluations > _PATIENCE and losses[-1] > (1 - _LEAST_GAIN) * losses[-1 - _PATIENCE]:
            converged = True
            break
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    seconds = time.perf_counter() - began
    return Minimum(best, history[-1].loss, converged, evaluations, evaluations, seconds, tuple(history))
