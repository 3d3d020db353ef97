"""What a camera makes of radiance: the curve from codes to linear values, known or estimated from a bracket."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from torchbrdf.brackets.samples import Samples
from torchbrdf.images import SRGB, Transfer

GRID = 257
"""Codes at which an estimated curve is recorded."""
_KNOTS = 14
_SMOOTHNESS = 0.03 * np.geomspace(1, 1e4, 5)
"""Of the departure from sRGB: stiffer where the curve does not rise everywhere. Frames whose exposures differ by one
factor throughout leave curves open that oscillate with it: smoothness decides there."""
_ROUNDS = 4
_NOISE_STEPS = 1.0 / 255
"""Of a code, by JPEG and the sensor together, in a patch's mean much less."""
_LOWEST = 0.25 / 255
_LEVELS = np.array([0.04, 0.08, 0.12, 0.18, 0.25, 0.33, 0.42, 0.52, 0.62, 0.72, 0.82, 0.9, 0.97])
_FEWEST = 40
_WORSE = 1.3
_FIXED = 0.5
"""The code at which an estimated curve has sRGB's value: what it cannot tell."""


@dataclass(frozen=True)
class Curve:
    """From codes in [0, 1] to linear values, for each channel.

    name    for people
    values  (3, GRID)  at codes from 0 to 1; None for those of `known`
    known   a function that is
    """

    name: str
    known: Transfer | None = None
    values: np.ndarray | None = None

    @classmethod
    def of(cls, transfer: Transfer) -> Curve:
        """The curve that a file names."""
        return cls(transfer.name, transfer)

    def decode(self, codes: np.ndarray, channel: int) -> np.ndarray:
        """Linear values of codes in [0, 1], of any shape."""
        if self.known is not None:
            return self.known.decode(codes)
        assert self.values is not None
        return self._splines[channel](codes)

    def decode_all(self, codes: np.ndarray) -> np.ndarray:
        """Linear values of codes (..., 3) of all channels."""
        return np.stack([self.decode(codes[..., k], k) for k in range(3)], axis=-1)

    def slope(self, codes: np.ndarray, channel: int) -> np.ndarray:
        """The derivative of `decode`."""
        step = 0.5 / GRID
        low, high = np.clip(codes - step, 0, 1), np.clip(codes + step, 0, 1)
        return (self.decode(high, channel) - self.decode(low, channel)) / (high - low)

    @cached_property
    def _splines(self) -> list:
        from scipy.interpolate import PchipInterpolator

        assert self.values is not None
        return [PchipInterpolator(np.linspace(0, 1, GRID), values) for values in self.values]


@dataclass(frozen=True)
class Consistency:
    """How well frames agree under a curve and exposures.

    misfit   robust relative deviation of a frame's radiance from the mean of all
    bias     the largest of such deviations that codes of like size have in common
    offsets  (F, 3)  log of each frame's radiance over that of most, by channel; 0 where nothing is shared
    """

    misfit: float
    bias: float
    offsets: np.ndarray

    def __str__(self) -> str:
        """What the larger of the two means, as the end of a sentence."""
        apart = max(self.misfit, self.bias) if np.isfinite(self.bias) else self.misfit
        return f"the radiance of the same patches differs by {np.expm1(apart):.0%} from one exposure to another"

    @property
    def by_frame(self) -> np.ndarray:
        """(F,) mean offset over channels."""
        return np.asarray(self.offsets.mean(axis=1))

    @property
    def by_colour(self) -> float:
        """How much more one channel of a frame departs than the others, at most."""
        return float(np.abs(self.offsets - self.offsets.mean(axis=1, keepdims=True)).max())

    def no_worse(self, other: Consistency, misfit: float, bias: float) -> bool:
        """Whether it is as good as another up to noise, or better than what is given."""
        return self.misfit <= max(misfit, _WORSE * other.misfit) and self.bias <= max(bias, _WORSE * other.bias)


def consistency(curve: Curve, samples: Samples, exposures: np.ndarray) -> Consistency:
    """Compare what frames say of the same patches.

    exposures  (F,)
    """
    radiance = curve.decode_all(samples.codes)
    with np.errstate(all="ignore"):
        logs = np.log(radiance) - np.log(exposures)[:, None, None]
    weights = np.where(np.isfinite(logs), _weights(curve, samples.codes, radiance), 0)
    residuals = _residuals(np.where(weights > 0, logs, 0), weights)
    shared = (weights > 0) & ((weights > 0).sum(axis=0) >= 2)
    if not shared.any():
        return Consistency(np.inf, np.inf, np.zeros((len(exposures), 3)))
    heavy = shared & (weights > np.median(weights[shared]))
    misfit = float(1.4826 * np.median(np.abs(residuals[heavy])))
    level = np.searchsorted(_LEVELS, np.nan_to_num(samples.codes))
    level[~shared] = -1
    common = [abs(np.median(residuals[of])) for k in range(1, len(_LEVELS)) if (of := level == k).sum() >= _FEWEST]
    return Consistency(misfit, float(max(common, default=np.inf)), _offsets(logs, weights))


def _offsets(logs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(F, 3): how far each frame is above the middle one, by what neighbours share: one that is wrong stands out."""
    offsets = np.zeros((len(logs), 3))
    for f in range(1, len(logs)):
        both = (weights[f] > 0) & (weights[f - 1] > 0)
        for k in range(3):
            step = logs[f, both[:, k], k] - logs[f - 1, both[:, k], k]
            offsets[f, k] = offsets[f - 1, k] + (np.median(step) if len(step) >= _FEWEST else 0)
    return np.asarray(offsets - np.median(offsets, axis=0))


def _weights(curve: Curve, codes: np.ndarray, radiance: np.ndarray) -> np.ndarray:
    """(F, N, 3): inverse variances of log radiance for noise of a code, and a floor for what is systematic."""
    slope = np.stack([curve.slope(codes[..., k], k) for k in range(3)], axis=-1)
    with np.errstate(all="ignore"):
        deviation = slope / radiance * _NOISE_STEPS
    return np.where(np.isfinite(deviation), 1 / (deviation**2 + 0.005**2), 0)


def _residuals(logs: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(F, N, 3): logs less their weighted mean over frames."""
    total = weights.sum(axis=0)
    return logs - (weights * logs).sum(axis=0) / np.where(total > 0, total, 1)


def estimate(samples: Samples, exposures: np.ndarray, shared: bool = True) -> Curve:
    """The curve under which frames agree best, as a smooth departure from sRGB's in log [DM97].

    shared  one curve for all channels, so that what is neutral stays neutral; else one for each
    """
    channels = [slice(None)] * 3 if shared else [slice(k, k + 1) for k in range(3)]
    grid = np.linspace(0, 1, GRID)
    fits = [_fit(samples.codes[..., one], exposures) for one in channels[: 1 if shared else 3]]
    values = np.stack([_curve(grid, fit) for fit in (fits * 3 if shared else fits)])
    return Curve("estimated from the brackets", values=values)


def _curve(codes: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Linear values: sRGB's, times the exponential of the departure."""
    safe = np.maximum(codes, _LOWEST)
    values = SRGB.decode(safe) * np.exp(_basis(safe) @ coefficients)
    return np.where(codes > 0, values, 0)


def _basis(codes: np.ndarray) -> np.ndarray:
    """(..., K): cubic B-splines over the square root of codes, 0 at the fixed code."""
    from scipy.interpolate import BSpline

    inner = np.linspace(0, 1, _KNOTS - 2)
    knots = np.concatenate([[0] * 3, inner, [1] * 3])
    count = len(knots) - 4
    spline = BSpline(knots, np.eye(count), 3)
    found: np.ndarray = spline(np.sqrt(np.clip(codes, 0, 1))) - spline(np.sqrt(_FIXED))
    return found


def _fit(codes: np.ndarray, exposures: np.ndarray) -> np.ndarray:
    """Coefficients of the departure, by least squares on what frames differ in, reweighted [HW77]."""
    grid = np.linspace(0, 1, GRID)
    basis = _basis(np.where(np.isfinite(codes), codes, _FIXED))  # (F, N, C, K)
    for smoothness in _SMOOTHNESS:
        coefficients = np.zeros(basis.shape[-1])
        for _ in range(_ROUNDS):
            coefficients = _reweighted(codes, basis, exposures, coefficients, smoothness)
        if (np.diff(_curve(grid, coefficients)) > 0).all():
            break
    return coefficients


def _reweighted(
    codes: np.ndarray, basis: np.ndarray, exposures: np.ndarray, coefficients: np.ndarray, smoothness: float
) -> np.ndarray:
    grid = np.linspace(0, 1, GRID)
    held = np.isfinite(codes)
    safe = np.where(held, codes, _FIXED)
    values = _curve(grid, coefficients)
    slope = np.maximum(np.gradient(np.log(np.maximum(values, 1e-12)), grid), 1e-2)
    deviation = np.interp(safe, grid, slope) * _NOISE_STEPS
    weights = held / (deviation**2 + 0.005**2)
    weights *= held.sum(axis=0) >= 2
    constants = np.log(SRGB.decode(np.maximum(safe, _LOWEST))) - np.log(exposures)[:, None, None]
    total = np.where((s := weights.sum(axis=0)) > 0, s, 1)
    centred = basis - ((weights[..., None] * basis).sum(axis=0) / total[..., None])
    target = constants - (weights * constants).sum(axis=0) / total
    residual = target + centred @ coefficients
    scale = 1.4826 * np.median(np.abs(residual[weights > 0] * np.sqrt(weights[weights > 0]))) + 1e-6
    robust = weights / np.maximum(1, np.abs(residual) * np.sqrt(weights) / (2 * scale))
    rows = centred.reshape(-1, centred.shape[-1])
    normal = (rows * robust.reshape(-1, 1)).T @ rows
    second = np.diff(np.eye(len(coefficients)), 2, axis=0)
    normal += smoothness * robust.sum() / len(coefficients) * 1e-2 * second.T @ second + 1e-9 * np.trace(
        normal
    ) * np.eye(len(normal))
    return np.linalg.solve(normal, -(rows * robust.reshape(-1, 1)).T @ target.ravel())
