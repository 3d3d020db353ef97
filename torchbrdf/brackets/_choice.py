"""Which response and which exposures the frames agree under."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from torchbrdf.brackets.calibration import Calibration
from torchbrdf.brackets.exposures import Exposures
from torchbrdf.brackets.frames import Frame
from torchbrdf.brackets.response import Consistency, Curve, consistency, estimate
from torchbrdf.brackets.samples import Samples
from torchbrdf.brackets.settings import Response
from torchbrdf.images import DECODERS, LINEAR

_FEWEST = 100
"""Patches that two frames share, below which nothing can be told of a response."""
_AGREE, _BIAS = 0.012, 0.03
"""Misfit and bias of frames that agree."""
_BETTER = 0.8
"""A second way must fit that much better than what the files say."""
_CONTRADICT = 0.15


@dataclass(frozen=True)
class Chosen:
    """A response and exposures, with how well frames agree under them.

    stops  whether times and apertures were taken at the stops that files round
    about  for people: which, and why
    """

    curve: Curve
    exposures: np.ndarray
    stops: bool
    found: Consistency
    about: str


def choose(
    frames: Sequence[Frame],
    samples: Samples,
    exposures: Exposures,
    response: Response | None,
    known: Calibration | None,
    like: str | os.PathLike[str] | None,
) -> Chosen:
    """The response wanted, or that of a picture merged before, or the best.

    Raises ValueError where no curve explains the frames, or they cannot be what is asked for.
    """
    if known is not None:
        return _as_before(frames, samples, exposures, response, known, os.fspath(like or ""))
    if not frames[0].integers:
        if response not in (None, "linear"):
            raise ValueError(f"{frames[0].path}: {frames[0].kind} is linear; leave --response {response} out")
        return _at_best_times(Curve.of(LINEAR), samples, exposures, f"linear, as {frames[0].kind} is")
    if response in ("linear", "srgb"):
        curve = Curve.of(DECODERS["linear" if response == "linear" else "srgb"])
        return _at_best_times(curve, samples, exposures, f"response {curve.name}, as given")
    guess = frames[0].transfer or DECODERS["srgb"]
    said = "as the files say" if frames[0].transfer else "as the exposures agree"
    if samples.count < _FEWEST:
        if response == "estimate":
            raise ValueError(
                f"{frames[0].path}: no two exposures show the same well enough to estimate the response; take them "
                "closer together, or give --response srgb or linear"
            )
        return Chosen(
            Curve.of(guess), exposures.said, False, consistency(Curve.of(guess), samples, exposures.said),
            f"response {guess.name}, not checked: no two exposures show the same",
        )  # fmt: skip
    guesses = [guess] if frames[0].transfer else [DECODERS["srgb"], DECODERS["gamma2.2"], LINEAR]
    tried = [_at_best_times(Curve.of(one), samples, exposures, f"response {one.name}, {said}") for one in guesses]
    best = min(tried, key=lambda one: one.found.misfit + one.found.bias)
    if response is None and best.found.misfit < _AGREE and best.found.bias < _BIAS:
        return best
    fitted = _estimated(samples, exposures)
    if fitted.found.misfit > _CONTRADICT:
        raise ValueError(
            f"{frames[0].path}: no response explains these exposures: {fitted.found}; the times are wrong "
            "(--times, in the order of the files), or scene, light or white balance changed: leave such files out"
        )
    if response == "estimate":
        return fitted
    if best.found.no_worse(fitted.found, _AGREE, _BIAS):
        return best
    why = f"under {best.curve.name} {best.found}"
    return Chosen(fitted.curve, fitted.exposures, fitted.stops, fitted.found, f"{fitted.about}: {why}")


def _as_before(
    frames: Sequence[Frame],
    samples: Samples,
    exposures: Exposures,
    response: Response | None,
    known: Calibration,
    like: str,
) -> Chosen:
    first = frames[0]
    if response is not None:
        raise ValueError(f"--like takes the response of {like}: leave --response {response} out")
    if known.unit != exposures.unit:
        raise ValueError(
            f"{like}: its radiance counts {known.unit}, and that of {first.path} {exposures.unit}: merge both with "
            "EXIF data of aperture and speed, or both without"
        )
    if known.camera and first.shooting.camera and known.camera != first.shooting.camera:
        raise ValueError(f"{like}: was taken with {known.camera}, and {first.path} with {first.shooting.camera}")
    if known.kind != first.kind:
        raise ValueError(
            f"{like}: was merged from {known.kind}, and {first.path} is {first.kind}: use files of one kind"
        )
    values = exposures.exact if known.stops else exposures.said
    found = consistency(known.curve, samples, values)
    return Chosen(known.curve, values, known.stops, found, f"response {known.curve.name}, as {like} has it")


def _at_best_times(curve: Curve, samples: Samples, exposures: Exposures, about: str) -> Chosen:
    """A curve with the exposures as files say them, or at the stops that they round, where that fits better."""
    said, exact = (consistency(curve, samples, values) for values in (exposures.said, exposures.exact))
    return _of_times(curve, curve, said, exact, exposures, about)


def _estimated(samples: Samples, exposures: Exposures) -> Chosen:
    said = _estimate(samples, exposures.said)
    curves = [said, said if np.allclose(exposures.said, exposures.exact) else _estimate(samples, exposures.exact)]
    found = [consistency(*one) for one in zip(curves, [samples] * 2, (exposures.said, exposures.exact), strict=True)]
    return _of_times(curves[0], curves[1], found[0], found[1], exposures, "response estimated from the brackets")


def _estimate(samples: Samples, exposures: np.ndarray) -> Curve:
    """One curve for all channels unless they contradict that."""
    common = estimate(samples, exposures)
    if (found := consistency(common, samples, exposures)).misfit < _AGREE and found.bias < _BIAS:
        return common
    each = estimate(samples, exposures, shared=False)
    one, other = (consistency(curve, samples, exposures) for curve in (common, each))
    return common if one.no_worse(other, _AGREE, _BIAS) else each


def _of_times(
    curve: Curve, at_stops: Curve, said: Consistency, exact: Consistency, exposures: Exposures, about: str
) -> Chosen:
    if _score(exact) < _BETTER * _score(said):
        told = f"{about}; times at whole, half or third stops, which fit better than as rounded (1/60 s is 1/64)"
        return Chosen(at_stops, exposures.exact, True, exact, told)
    return Chosen(curve, exposures.said, False, said, about)


def _score(found: Consistency) -> float:
    """How far frames depart from their exposures."""
    return float(np.hypot(np.sqrt((found.by_frame**2).mean()), 0.1 * found.misfit)) + 1e-4
