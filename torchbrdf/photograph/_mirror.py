"""The outline of a mirror, which shows at its rim what lies beside it: where directions begin to crowd.

Across an outline radiance goes on where it was. A direction by an angle beyond the rim is seen outside, and again
inside by reflection, where a degree is crowded into a fraction of a pixel. Radiance along such a line of directions is
taken for a Brownian motion, whatever lies there; an outline is where its steps grow as a mirror crowds them.
"""

from __future__ import annotations

from math import radians

import numpy as np

from torchbrdf.photograph._charts import Chart
from torchbrdf.photograph._outline import BESIDE, Outline, along, climb, guess
from torchbrdf.photograph._pyramid import Pyramid
from torchbrdf.photograph._rim import OUTLIERS, Rays, through_lens

_REFLECTANCES = 1.0, 0.6, None
"""To choose the likelier from; None is what shows inside something else than outside: a ball that is no mirror."""

_SIDE = 4.0
"""Pixels on either side of the farthest outlines that are compared."""

_APART = radians(4)
"""Angle in which one radius outside is seen; that it is small is what counts."""

_NOISE = 1e-4, 1e-3, 1e-2, 1e-1, 1.0
"""Variances of the noise to choose from: of radiance that is Brownian with a variance of 1 after a radian."""

_WHITE = 0.1
"""Share of the noise that neighbouring samples do not share, and of what no model holds."""

_UNKNOWN = 1e3
"""Variance of the level along a ray, in variances of what is seen there."""

_TEMPER = 0.25
"""Of the evidence: rays and channels are not independent."""

_CLEAR = 2.0
"""Score from which on edges alone place an outline well."""

_LEAST_RADIUS = 32.0
"""Pixels of the level below which a pixel and a half is enough to find some outline anywhere."""

_REACH, _OFFSETS = 1.5, 25
"""Pixels by which an outline may move, and in how many steps."""

_RAYS = 300
_BLURS = 0.45, 0.6, 0.8, 1.05, 1.4
_LIKELIHOOD = 0.1
"""Weight of a model's likelihood beside the score that its votes reach."""

_ALIKE = 0.5
"""A ray's share of such goodness by which models are about as good as the best."""

_LEAST = 1e-12


def settled(outline: Outline, pyramid: Pyramid, chart: Chart, wanted: float) -> Outline:
    """An outline where edges and what goes on across it agree best; as it is where edges alone place it well.

    It tells how far from there edges alone, and other models that are about as good, place it.
    wanted  pixels of the radius at the pyramid's level, about
    """
    pixels = outline.place[2] / 2 ** pyramid.level(outline.place[2], wanted)
    if outline.score >= _CLEAR or pixels < _LEAST_RADIUS:
        return outline
    reach, n = _REACH / pixels, int(min(_RAYS, 2 * np.pi * pixels))
    rays = Rays.across(pyramid, chart, outline.place, wanted, reach + BESIDE / pixels, n, None)
    if not len(rays.angles):
        return outline
    offsets, basis = np.linspace(-reach, reach, _OFFSETS), rays.harmonics()
    trials = []
    for blur, edges in zip(_BLURS, rays.votes(offsets, _BLURS), strict=True):
        for reflectance in _REFLECTANCES:
            likely = _log_likelihoods(rays, offsets, blur, reflectance)
            votes = edges + _votes(likely)
            shift, score = climb(votes, basis, offsets, guess(votes, basis, offsets))
            good = score + _LIKELIHOOD * float(along(likely, basis @ shift, offsets).sum())
            trials.append((good, votes, shift))
    most, votes, best = max(trials, key=lambda trial: trial[0])
    others = [np.zeros(3), *(shift for good, _, shift in trials if good > most - _ALIKE * n)]
    doubt = max(float(np.abs(other - best).max()) for other in others)
    return Outline(outline.place, rays, offsets, votes, best, n, doubt)


def _votes(likely: np.ndarray) -> np.ndarray:
    """(A, R): log of how much likelier than anywhere, of log likelihoods."""
    share = np.exp(likely - likely.max(1, keepdims=True))
    return np.asarray(np.log((1 - OUTLIERS) * share / share.mean(1, keepdims=True) + OUTLIERS))


def _log_likelihoods(rays: Rays, offsets: np.ndarray, blur: float, reflectance: float | None) -> np.ndarray:
    """(A, R): of what each ray shows, with the outline of a mirror at each offset (R,) in radii.

    blur  standard deviation of what lens and pixels do, in pixels of the level
    The scale of radiance is each ray's own and is left out, as is its level; noise is what fits.
    """
    near = np.abs(rays.distances) <= np.abs(offsets).max() + _SIDE / rays.pixels
    values = rays.values[:, near]
    a, p, c = values.shape
    y = (values / (np.abs(values).mean(1, keepdims=True) + 1e-30)).transpose(1, 0, 2).reshape(p, a * c)
    root = np.linalg.cholesky(_covariances(rays.distances[near], rays.pixels, offsets, blur, reflectance))
    volume = 2 * np.log(np.diagonal(root, axis1=-2, axis2=-1)).sum(-1)
    white = np.linalg.inv(root).astype(np.float32)
    squares = np.stack([((each @ y.astype(np.float32)) ** 2).sum(1) for each in white])
    likely = -0.5 * (volume[..., None] + p * np.log(squares / p + _LEAST))
    most = likely.max((0, 1), keepdims=True)
    whole = np.log(np.exp(likely - most).mean(1)) + most[:, 0]
    return np.asarray(_TEMPER * whole.reshape(len(offsets), a, c).sum(2).T, np.float64)


def _covariances(
    distances: np.ndarray, pixels: float, offsets: np.ndarray, blur: float, reflectance: float | None
) -> np.ndarray:
    """(R, S, P, P): of samples (P,), for an outline at each offset (R,) and each noise (S,)."""
    fine, lens = through_lens(distances, blur / pixels)
    depth = 1 - (1 + fine) / (1 + offsets[:, None])
    inside = depth > 0
    gain = np.where(inside, 1.0 if reflectance is None else reflectance, 1.0)
    beyond = 2 * np.arccos(np.clip(1 - depth, 0, 1)) - _APART * depth
    shown = lens * gain[:, None]
    texture = shown @ np.minimum(beyond[:, :, None], beyond[:, None, :]) @ shown.transpose(0, 2, 1)
    away = np.abs(distances[:, None] - distances) * pixels
    shared = np.where(away < 1, 1 - 1.5 * away**2 + 0.75 * away**3, np.maximum(2 - away, 0) ** 3 / 4)
    noise = (1 - _WHITE) * shared + _WHITE * np.eye(len(distances))
    levels = shown.sum(-1)[..., None]
    if reflectance is None:
        levels = np.stack([shown.sum(-1), (lens * inside[:, None]).sum(-1)], -1)
    both = texture[:, None] + np.array(_NOISE)[:, None, None] * noise
    size = np.trace(both, axis1=-2, axis2=-1)[..., None, None] / len(distances)
    return np.asarray(both + _UNKNOWN * size * (levels @ levels.transpose(0, 2, 1))[:, None])
