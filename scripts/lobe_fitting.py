"""Levenberg-Marquardt fits of the lobes of torchbrdf.brdf.lobes to tables, many columns in one batch."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from tqdm import tqdm

from torchbrdf.brdf import GRID, cell_centres, from_half_difference
from torchbrdf.brdf.lobes import PARAMETER_NAMES

N_PARAMETERS = len(PARAMETER_NAMES)
POSITIVE = torch.tensor(
    [name in ("strength", "width", "bend", "decay", "grazing", "exponent", "softness") for name in PARAMETER_NAMES]
)  # fitted as logarithms
LOWER = torch.tensor([-20.0, -18.0, -1.5, -3.5, -6.0, -8.0, -8.0, -1.5, -8.0, -2.5, -4.5])
UPPER = torch.tensor([12.0, 3.0, 1.2, 4.0, 6.0, 8.0, 10.0, 2.5, 8.0, 2.5, 1.5])
DARK = 0.002  # 1/sr; relative errors of values far below this do not count
SCALES = {"uniform": 0.0035, "cells": 0.05, "relative": 3.0, "norm": 0.25, "albedo": 0.03}
"""Errors of each kind that count alike."""

COLUMNS_AT_ONCE = 10
SAVE_EVERY = 10  # iterations


@dataclass(frozen=True)
class Samples:
    """Cells of the tables, and how much each counts in the mean of each kind of error (0 where it does not).

    cells    (S,)    flat indices
    cos_i    (S,)    cosine of theta_i
    weights  each name of SCALES -> (S,)
    f_r      (n, S)  values of the tables
    """

    cells: Tensor
    cos_i: Tensor
    weights: dict[str, Tensor]
    f_r: Tensor


@dataclass(frozen=True)
class Geometry:
    """What the model needs of a cell, each (S,) float32."""

    log_x: Tensor
    u: Tensor
    cos_i: Tensor
    cos_o: Tensor

    @classmethod
    def of_cells(cls, cells: Tensor) -> "Geometry":
        """At the centres of flat cell indices."""
        theta_h, theta_d, phi_d = cell_angles(cells)
        z_i, z_o = (w[..., 2] for w in from_half_difference(theta_h, theta_d, phi_d))
        log_x, u = torch.log(2 * torch.sin(theta_h / 2) ** 2), 2 * torch.sin(theta_d / 2) ** 2
        return cls(*(x.float() for x in (log_x, u, z_i.clamp_min(0), z_o.clamp_min(0))))


def cell_angles(cells: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """theta_h, theta_d, phi_d (S,) of flat cell indices."""
    theta_h, theta_d, phi_d = (angle.ravel() for angle in cell_centres())
    return (
        theta_h[cells // (GRID[1] * GRID[2])],
        theta_d[cells // GRID[2] % GRID[1]],
        phi_d[cells % GRID[2]],
    )


def model(p: Tensor, at: Geometry, jacobian: bool = False) -> tuple[Tensor, Tensor]:
    """evaluate_lobes in the fitted variables, and its derivatives.

    p        (n, lobes, N_PARAMETERS)  logarithms where POSITIVE
    returns  f_r (n, S), jacobian (n, lobes * N_PARAMETERS, S), empty unless asked for
    """
    n, lobes, _ = p.shape
    total = torch.zeros(n, len(at.u))
    derivative = torch.empty(n, lobes, N_PARAMETERS, len(at.u) if jacobian else 0)
    log_u = torch.log(at.u)
    for lobe in range(lobes):
        k, width, bend, decay, s, t, grazing, exponent, slope, g, softness = p[:, lobe, :, None].unbind(1)
        q, c, rise, power, a = bend.exp(), decay.exp(), grazing.exp() - 1, exponent.exp(), softness.exp()
        m = at.log_x - width - at.u * (s + at.u * t)
        z = (q * m).clamp(max=60).exp()
        log_d = torch.log1p(z)
        u_power = (power * log_u).exp()
        fresnel = 1 + rise * u_power
        near_i, near_o = at.cos_i + a, at.cos_o + a
        log_g = torch.log(near_i * near_o)
        f = (k - c * log_d + torch.log(fresnel) + slope * at.u - g * log_g).clamp(max=40).exp()
        total += f
        if jacobian:
            out = derivative[:, lobe]
            steepness = c * z / (1 + z) * f * q
            out[:, 0], out[:, 1], out[:, 2], out[:, 3] = f, steepness, -steepness * m, -c * log_d * f
            out[:, 4], out[:, 5] = steepness * at.u, steepness * at.u**2
            ratio = u_power / fresnel * f
            out[:, 6], out[:, 7], out[:, 8] = (rise + 1) * ratio, rise * power * ratio * log_u, at.u * f
            out[:, 9], out[:, 10] = -log_g * f, -g * a * (1 / near_i + 1 / near_o) * f
    return total, derivative.reshape(n, lobes * N_PARAMETERS, -1)


class Objective:
    """The robust loss of every column on a set of samples, and its Gauss-Newton normal equations.

    The sum over kinds of error of error / scale:
    uniform, cells  means of |log(1 + f cos) - log(1 + g cos)|
    relative        mean of |log(f + DARK) - log(g + DARK)|
    norm            |f - g| / |g| over cells
    albedo          |log albedo(f) - log albedo(g)|
    |r| is smoothed to sqrt(r^2 + e^2), and acts as a square of weight 1 / sqrt(r^2 + e^2) in the normal
    equations. All residuals but the albedo's depend on the parameters through one f_r each: their weights
    add up.
    """

    def __init__(self, samples: Samples, workers: ThreadPoolExecutor) -> None:
        """Columns are worked on a few at a time, each group by one worker."""
        self.workers = workers
        self.geometry = Geometry.of_cells(samples.cells)
        self.cos_i, self.f_r = samples.cos_i, samples.f_r
        self.target = torch.log1p(samples.f_r * samples.cos_i)
        self.log_target = torch.log(samples.f_r + DARK)
        weights = samples.weights
        self.weight = weights["uniform"] / SCALES["uniform"] + weights["cells"] / SCALES["cells"]
        self.smooth = torch.where(weights["uniform"] > 0, SCALES["uniform"], SCALES["cells"])
        self.log_weight = weights["relative"] / SCALES["relative"]
        self.norm_weight = weights["norm"]
        self.norm = torch.sqrt(samples.f_r**2 @ weights["norm"])
        self.albedo_weight = weights["albedo"]
        self.albedo = samples.f_r @ weights["albedo"]

    def residuals(self, f_r: Tensor, columns: Tensor, eps: float) -> "Residuals":
        """For values f_r (m, S) of the given columns (m,)."""
        r = torch.log1p(f_r * self.cos_i) - self.target[columns]
        r_log = torch.log(f_r + DARK) - self.log_target[columns]
        h, h_log = torch.sqrt(r**2 + (eps * self.smooth) ** 2), torch.sqrt(r_log**2 + (0.5 * eps) ** 2)
        difference = (f_r - self.f_r[columns]) / self.norm[columns, None]
        h_norm = torch.sqrt(difference**2 @ self.norm_weight + (eps * SCALES["norm"]) ** 2)
        r_albedo = torch.log(f_r @ self.albedo_weight / self.albedo[columns]) / SCALES["albedo"]
        h_albedo = torch.sqrt(r_albedo**2 + 1)
        loss = h @ self.weight + h_log @ self.log_weight + h_norm / SCALES["norm"] + h_albedo - 1
        return Residuals(loss, r, h, r_log, h_log, difference, h_norm, r_albedo, h_albedo)

    def loss(self, p: Tensor, columns: Tensor, eps: float) -> Tensor:
        """(m,) for parameters (m, lobes, N_PARAMETERS) of the given columns (m,)."""

        def part(p: Tensor, columns: Tensor) -> Tensor:
            return self.residuals(model(p, self.geometry)[0], columns, eps).loss

        return torch.cat(list(self.workers.map(part, p.split(COLUMNS_AT_ONCE), columns.split(COLUMNS_AT_ONCE))))

    def normal_equations(self, p: Tensor, columns: Tensor, eps: float) -> tuple[Tensor, Tensor, Tensor]:
        """loss (m,), curvature (m, P, P) and gradient (m, P) in float64, P = lobes * N_PARAMETERS."""

        def part(p: Tensor, columns: Tensor) -> tuple[Tensor, Tensor, Tensor]:
            return self._normal_equations(p, columns, eps)

        parts = self.workers.map(part, p.split(COLUMNS_AT_ONCE), columns.split(COLUMNS_AT_ONCE))
        loss, curvature, gradient = (torch.cat(list(tensors)) for tensors in zip(*parts, strict=True))
        return loss, curvature.double(), gradient.double()

    def _normal_equations(self, p: Tensor, columns: Tensor, eps: float) -> tuple[Tensor, Tensor, Tensor]:
        f_r, jacobian = model(p, self.geometry, jacobian=True)
        at = self.residuals(f_r, columns, eps)
        d, d_log, d_norm = self.cos_i / (1 + f_r * self.cos_i), 1 / (f_r + DARK), 1 / self.norm[columns, None]
        w, w_log = self.weight / at.h, self.log_weight / at.h_log
        w_norm = self.norm_weight / (at.h_norm[:, None] * SCALES["norm"])
        curvature = (jacobian * (w * d**2 + w_log * d_log**2 + w_norm * d_norm**2)[:, None]) @ jacobian.mT
        slope = w * d * at.r + w_log * d_log * at.r_log + w_norm * d_norm * at.difference
        gradient = (jacobian @ slope[..., None])[..., 0]
        j_albedo = jacobian @ self.albedo_weight / (f_r @ self.albedo_weight * SCALES["albedo"])[:, None]
        curvature += j_albedo[:, :, None] * (j_albedo / at.h_albedo[:, None])[:, None]
        return at.loss, curvature, gradient + (at.r_albedo / at.h_albedo)[:, None] * j_albedo


class Residuals(NamedTuple):
    """Loss (m,) of m columns, residuals r and their smoothed sizes h."""

    loss: Tensor
    r: Tensor
    h: Tensor
    r_log: Tensor
    h_log: Tensor
    difference: Tensor
    h_norm: Tensor
    r_albedo: Tensor
    h_albedo: Tensor


@dataclass
class State:
    """Where a minimisation stands: parameters, damping and loss of m columns, and iterations done."""

    p: Tensor
    damping: Tensor
    loss: Tensor
    iteration: int = 0

    @classmethod
    def start(cls, p: Tensor) -> "State":
        """Before the first iteration."""
        return cls(p, torch.full((len(p),), 1e-2, dtype=torch.float64), torch.full((len(p),), torch.inf))


def minimise(
    objective: Objective,
    state: State,
    columns: Tensor,
    iterations: int,
    eps: tuple[float, float],
    label: str,
    save: Callable[[State], None],
) -> State:
    """Levenberg-Marquardt within the box LOWER..UPPER; eps goes from eps[0] to eps[1] over the first 70 %."""
    lobes = state.p.shape[1]
    low, high = (bound.repeat(lobes).double() for bound in (LOWER, UPPER))
    with tqdm(total=iterations, initial=state.iteration, desc=label, unit="it") as bar:
        for i in range(state.iteration, iterations):
            e = eps[0] * (eps[1] / eps[0]) ** min(1.0, i / (0.7 * iterations))
            start, curvature, gradient = objective.normal_equations(state.p, columns, e)
            flat = state.p.flatten(1).double()
            pushed = ((flat <= low + 1e-6) & (gradient > 0)) | ((flat >= high - 1e-6) & (gradient < 0))
            free = (~pushed).double()  # a variable held by its bound stays out of the step
            curvature = curvature * free[:, :, None] * free[:, None]
            diagonal = torch.diagonal(curvature, dim1=1, dim2=2)
            ridge = diagonal + 1e-3 * diagonal.mean(1, keepdim=True) + 1e-9
            state.loss, todo = start.clone(), torch.arange(len(columns))
            for _ in range(2):
                damped = curvature[todo] + torch.diag_embed(state.damping[todo, None] * ridge[todo] + 1 - free[todo])
                step = torch.linalg.solve(damped, (gradient * free)[todo]).clamp(-1.5, 1.5)
                trial = torch.minimum(torch.maximum(flat[todo] - step, low), high).float().unflatten(1, (lobes, -1))
                loss = objective.loss(trial, columns[todo], e)
                better = loss < start[todo]
                state.p[todo[better]], state.loss[todo[better]] = trial[better], loss[better]
                state.damping[todo] *= torch.where(better, 0.3, 6.0)
                todo = todo[~better]
                if len(todo) == 0:
                    break
            state.damping.clamp_(1e-7, 1e4)
            state.iteration = i + 1
            bar.update()
            bar.set_postfix(median=f"{state.loss.median():.4f}", worst=f"{state.loss.max():.3f}")
            if state.iteration % SAVE_EVERY == 0 or state.iteration == iterations:
                save(state)
    return state


def to_parameters(p: Tensor) -> dict[str, Tensor]:
    """The fitted variables (n, lobes, N_PARAMETERS) as parameters of torchbrdf.brdf.lobes."""
    natural = torch.where(POSITIVE, p.exp(), p)
    return {name: natural[..., i].contiguous() for i, name in enumerate(PARAMETER_NAMES)}
