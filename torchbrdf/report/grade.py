"""Whether a result is good: a word for how far off pictures of it under other light are expected to be."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

from torchbrdf.report.advice import Topic

Word = Literal["Good", "Fair", "Poor", "Not graded"]

GOOD_ERROR, FAIR_ERROR = 0.05, 0.15
"""Relative RMS error under other light that the words stand for."""

GOOD_SPREAD, FAIR_SPREAD = 0.06, 0.20
"""Relative standard deviation of the picture under another light, at most: of left-out materials the error is half of
it in the median, whatever the capture's defect, and 1.7 times at most (docs/uncertainty.md)."""

GOOD_RESIDUAL, FAIR_RESIDUAL = 0.03, 0.10
"""Of the photograph, at most. The standard deviation knows of a misfit; this is for misfits of kinds not tried."""

SPOILS: frozenset[Topic] = frozenset({"normals", "reflectance", "too-bright", "too-dark", "uncertain"})
"""Warnings with which a result is poor."""

HARMLESS: frozenset[Topic] = frozenset({"class", "clamped", "dark-middle"})
"""Warnings that a good result may have: with them the error is no larger for its standard deviation than without."""


@dataclass(frozen=True)
class Grade:
    """A word, and what it stands for."""

    word: Word
    meaning: str

    def __str__(self) -> str:
        """For a line."""
        return f"{self.word.lower()}: {self.meaning[0].lower()}{self.meaning[1:].removesuffix('.')}"


_OFF = "Pictures of it under other light are expected to be off by"

GRADES: dict[Word, Grade] = {
    one.word: one
    for one in (
        Grade("Good", f"{_OFF} less than {GOOD_ERROR:.0%}."),
        Grade("Fair", f"{_OFF} less than {FAIR_ERROR:.0%}."),
        Grade("Poor", f"Pictures of it under other light may be off by {FAIR_ERROR:.0%} or more."),
        Grade("Not graded", "A fixed penalty does not tell how far off pictures of it under other light are."),
    )
}


def shortcomings(error: float, spread: float | None) -> list[Topic]:
    """What keeps a result from being good, there being no warning."""
    found: list[Topic] = ["unexplained"] if error > GOOD_RESIDUAL else []
    return [*found, "uncertain"] if spread is not None and spread > GOOD_SPREAD else found


def grade_of(error: float, spread: float | None, doubted: Collection[Topic]) -> Grade:
    """The grade of a result.

    error    |Y w - y| / |y| on the photograph
    spread   relative standard deviation of the picture under another light; None where that is not known
    doubted  topics of the warnings
    """
    if SPOILS.intersection(doubted) or error > FAIR_RESIDUAL or (spread is not None and spread > FAIR_SPREAD):
        return GRADES["Poor"]
    if spread is None:
        return GRADES["Not graded"]
    if shortcomings(error, spread) or not HARMLESS.issuperset(doubted):
        return GRADES["Fair"]
    return GRADES["Good"]
