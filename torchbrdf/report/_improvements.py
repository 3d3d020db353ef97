"""What would make a result better: the actions that help most."""

from collections.abc import Collection, Iterable, Sequence

from torchbrdf.estimation import Gap
from torchbrdf.report.advice import ADVICE, Topic

MOST = 2
"""Actions at once: who is told ten does none."""

_CAPTURE: tuple[Topic, ...] = (
    "normals", "camera", "clipped-light", "no-unit", "reflectance", "clipped", "too-bright", "unexplained",
)  # fmt: skip
_ORDER: tuple[Topic, ...] = (*_CAPTURE, "gloss", "shadow", "uncertain", "grazing", "dark-middle", "clamped")
"""Errors of the capture first, as more light does not mend them; then what the light leaves open, the worst first; then
what another fit of the same photograph mends."""

_SAME: tuple[set[Topic], ...] = ({"gloss", "shadow", "uncertain", "grazing"}, {"dark-middle", "clamped"})
"""More light or a second photograph, and another constraint: one topic of each says it."""


def improvements(doubted: Iterable[Topic], gaps: Sequence[Gap]) -> list[Topic]:
    """What to act on, what helps most first.

    doubted  topics of the warnings, and of what keeps the result from being good
    gaps     of the light
    """
    found = [topic for topic in _ORDER if topic in {*doubted, *gaps}]
    said_before = {topic for same in _SAME for topic in [one for one in found if one in same][1:]}
    return [topic for topic in found if topic not in said_before and ADVICE[topic].actions][:MOST]


def sentence(topic: Topic, tried: Collection[str]) -> str:
    """What to do, as a sentence, without options that were tried; empty where nothing is left."""
    clauses = [clause for clause in ADVICE[topic].actions if not any(f"`{option}`" in clause for option in tried)]
    if not clauses:
        return ""
    text = ", or ".join(filter(None, ("; ".join(clauses[:-1]), clauses[-1])))
    return f"{text[0].upper()}{text[1:]}."
