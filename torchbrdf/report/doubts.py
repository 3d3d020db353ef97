"""What a reader should know before trusting a result, with a report of it or without."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import torch
from torch import Tensor

from torchbrdf.brdf import GRID, MerlTable, directional_albedo, reflects_too_much
from torchbrdf.estimation import Reconstruction
from torchbrdf.report.advice import Topic
from torchbrdf.report.grade import HARMLESS
from torchbrdf.transport import BasisImages

LARGE_RESIDUAL = 0.05
"""Relative error on the photograph above which a result is warned of."""

SMALL_MARGIN = 1.1
"""With a fixed penalty there is one where the second best class leaves less than this times the best's residual."""

LITTLE_ALBEDO = 0.004
"""Directional albedo at all angles below which there is one: black fabric, the darkest of the library, has 0.015."""

SMALL_PROBABILITY = 0.5
"""With probabilities there is a warning where that of the most probable class is below this, so that the others
together are more probable: three in ten of the measured photographs of docs/accuracy.md."""

LARGE_SPREAD = 0.25
"""Relative standard deviation of the picture under another light above which there is one: one in twenty there."""

OSCILLATION = 30.0
"""With a fixed penalty there is one where sum |w| exceeds this times |sum w|: large weights of both signs cancel.

On real materials lambda = 0.5 stays near 3, lambda = 0.005 below 30, and least squares exceeds 100. Of averages over
priors it tells nothing: with it the error is no larger for its standard deviation (docs/uncertainty.md).
"""

LARGE_CLAMPED_SHARE = 0.02
"""Share of values set to zero above which there is a warning."""

DARK_MIDDLE = 1 / 3
"""Share of a highlight's brightest of which less in its middle is pointed out: more than half of what is recovered of
measured materials, none of these and of the library's (docs/constraints.md)."""

_HIGHLIGHT = slice(0, 19), slice(0, 90, 15), GRID[2] // 2
"""Cells to 4 degrees of the middle of highlights at some theta_d, across the plane of incidence."""

SMALL_SHARE = 0.25
"""Share of the pixels that show the shape below which there is a warning that few are used."""


class ClassFigures(Protocol):
    """What one class makes of a photograph: its index, its probability (None with a fixed penalty), |Y w - y| / |y|."""

    @property
    def index(self) -> int | None: ...  # noqa: D102
    @property
    def probability(self) -> float | None: ...  # noqa: D102
    @property
    def error(self) -> float: ...  # noqa: D102


Figures = TypeVar("Figures", bound=ClassFigures)


@dataclass(frozen=True)
class Doubt:
    """A reason to doubt a result: what it is about, for `ADVICE`, and a sentence or two."""

    topic: Topic
    text: str

    def __str__(self) -> str:
        """The sentences."""
        return self.text

    @property
    def is_harmless(self) -> bool:
        """Whether a good result may have it."""
        return self.topic in HARMLESS


@dataclass(frozen=True)
class ClassShare:
    """Such figures."""

    index: int
    probability: float | None
    error: float


def second_best(classes: Sequence[Figures], chosen: int) -> Figures | None:
    """The most probable of the other classes, with a fixed penalty that of smallest error; None where there is none."""
    others = [one for one in classes if one.index != chosen]
    return min(others, key=lambda other: (-(other.probability or 0.0), other.error)) if others else None


def margin(best: ClassFigures, second: ClassFigures | None) -> float:
    """The second best's error over that of the best; infinite without a second or without a residual."""
    return float("inf") if second is None or best.error == 0 else second.error / best.error


def oscillation_of(weights: Tensor) -> float:
    """sum |w| / |sum w| of weights (n, 3), both added up over the channels: one channel's sum may pass through 0."""
    return float(weights.abs().sum() / weights.sum(0).abs().sum().clamp_min(1e-12))


def clamped_share(table: MerlTable) -> float:
    """Share of a table's measured values that are exactly zero: a combination is so only where it was clamped."""
    zero = (table.values == 0) & table.valid[..., None]
    return int(torch.count_nonzero(zero)) / (3 * int(torch.count_nonzero(table.valid)))


def darkest_middle(table: MerlTable) -> float:
    """How bright the middle of highlights is beside the brightest within 4 degrees, where least: 1 is falling off."""
    f_r = table.filled.reshape(*GRID, 3)[_HIGHLIGHT].mean(-1)
    brightest = f_r.amax(0)
    return float(torch.where(brightest > 0, f_r[0] / brightest, 1).amin())


def doubts(
    *,
    error: float,
    classes: Sequence[ClassFigures],
    chosen: int,
    albedo: Tensor,
    oscillation: float,
    clamped: float,
    middle: float,
    distrust: str | None,
    spread: float | None,
) -> list[Doubt]:
    """The reasons to doubt a result.

    error     |Y w - y| / |y| of the result
    chosen    the best of the classes
    albedo    (4,)    directional, see `directional_albedo`, mean of R, G, B
    oscillation  of the weights, see `oscillation_of`
    clamped   share of measured values at zero
    middle    of highlights, see `darkest_middle`
    distrust  why the shape tells too little (`BasisImages.distrust`), or None
    spread    relative standard deviation of the picture under another light; None where that is not known
    """
    found: list[Doubt] = []

    def doubt(topic: Topic, text: str) -> None:
        found.append(Doubt(topic, text))

    if distrust is not None:
        doubt("normals", f"{distrust[0].upper()}{distrust[1:]}.")
    if error > LARGE_RESIDUAL:
        doubt(
            "unexplained",
            f"The fit leaves {error:.1%} of the photograph unexplained. The probe may be of another place or time, or "
            "turned or scaled against the photograph; the silhouette may be another; the photograph may hold clipped "
            "highlights, shadows or reflections of things near by; or the library lacks this kind of material."
        )
    units = "The photograph and the light probe are in different units; scale one of them."
    if error > LARGE_RESIDUAL:  # then another light explains that, too
        units = "The light probe is that of another light, or photograph and probe are in different units."
    if (too_much := reflects_too_much(albedo)) is not None:
        doubt(
            "too-bright",
            f"The result {too_much}: no material does. {units}"
        )
    if float(albedo.max()) < LITTLE_ALBEDO:
        doubt(
            "too-dark",
            f"The result reflects {float(albedo.max()):.2g} of the light at most, less than black cloth does. {units}"
        )
    best, second = classes[chosen], second_best(classes, chosen)
    if second is not None and best.probability is not None and best.probability < SMALL_PROBABILITY:
        doubt(
            "class",
            f"The photograph does not tell the class: class {chosen} has a probability of "
            f"{best.probability:.0%}, class {second.index} of {second.probability:.0%}. The result lies "
            "between them. Compare the two in the report."
        )
    elif second is not None and best.probability is None and margin(best, second) < SMALL_MARGIN:
        doubt(
            "class",
            f"Class {second.index} fits almost as well as class {chosen} "
            f"({second.error:.2%} against {best.error:.2%}): the choice could have gone the other "
            "way. Compare the two in the report."
        )
    if spread is not None and spread > LARGE_SPREAD:
        doubt(
            "uncertain",
            f"Under another light the picture is uncertain by {spread:.0%} (one standard deviation): "
            "this photograph leaves much of the BRDF to the library. A light with more contrast, or a second "
            "photograph under another light, would tell more."
        )
    if best.probability is None and oscillation > OSCILLATION:
        doubt(
            "oscillation",
            f"The weights oscillate: their magnitudes add up to {oscillation:.0f} times their sum, so large "
            "positive and negative weights cancel each other. That fits this photograph and rarely any other; a "
            "larger penalty helps."
        )
    if clamped > LARGE_CLAMPED_SHARE:
        doubt(
            "clamped",
            f"{clamped:.1%} of the table's values came out negative and were set to zero. "
            "That changes nothing under light like the photograph's; under a single lamp, look for black spots and "
            "rings."
        )
    if middle < DARK_MIDDLE:
        doubt(
            "dark-middle",
            f"Highlights come out {middle:.0%} as bright in their middle as beside it: the photograph does not tell "
            "the last degree about the mirror direction. A point light would show a dark spot."
        )
    return found


def few_pixels(used: int, seen: int) -> str | None:
    """That few of the pixels that show the shape are used; None where they suffice."""
    return f"only {used} of the shape's {seen} pixels are used" if used < SMALL_SHARE * seen else None


def doubts_without_pictures(result: Reconstruction, basis: BasisImages, table: MerlTable) -> list[Doubt]:
    """The doubts about a single result of which no report is made: all but that about another light."""
    errors = (result.class_errors / result.energy).clamp_min(0).sqrt().tolist()
    probabilities = [None] * len(errors) if result.posteriors is None else result.class_probabilities.tolist()
    return doubts(
        error=float(result.relative_error),
        classes=[ClassShare(j, *figures) for j, figures in enumerate(zip(probabilities, errors, strict=True))],
        chosen=int(result.class_index),
        albedo=directional_albedo(table).mean(1),
        oscillation=oscillation_of(result.weights.detach().cpu().double()),
        clamped=clamped_share(table),
        middle=darkest_middle(table),
        distrust=basis.distrust,
        spread=None,
    )


def doubts_of_result(
    result: Reconstruction, basis: BasisImages, table: MerlTable, mask: Tensor | None = None
) -> list[str]:
    """The reasons to doubt a single result, in a sentence or two each, as the commands say them.

    basis   of the photograph; of several photographs those of any
    table   `result.brdf(library)`
    mask    (1, H, W) bool as the estimator took it; None for all pixels
    All but that the picture is uncertain under another light, which needs basis images there: `result.image_std`.
    Raises ValueError for a batch, and a mask of another size.
    """
    if result.class_index.ndim:
        raise ValueError("doubts are of a single reconstruction, this holds a batch; pick one: result[i]")
    if mask is not None and mask.shape != basis.mask.shape:
        raise ValueError(f"mask must be {tuple(basis.mask.shape)} like the basis images', got {tuple(mask.shape)}")
    few = None if mask is None else few_pixels(int(basis.pack(mask).sum()), basis.packed.shape[-1])
    return [*([few] if few else []), *map(str, doubts_without_pictures(result, basis, table))]
