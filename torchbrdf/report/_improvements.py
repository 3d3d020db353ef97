"""What would make a result better: the actions that help most."""

from collections.abc import Collection, Iterable, Sequence

from torchbrdf.estimation import Gap
from torchbrdf.report.advice import ADVICE, Topic

MOST = 2
"""Actions at once: who is told ten does none."""

_CAPTURE: tuple[Topic, ...] = (
    "normals", "camera", "clipped-light", "no-unit", "negative", "reflectance", "clipped", "too-bright", "too-dark",
    "unexplained",
)  # fmt: skip
_ORDER: tuple[Topic, ...] = (*_CAPTURE, "gloss", "shadow", "uncertain", "grazing", "dark-middle", "clamped")
"""Errors of the capture first, as more light does not mend them; then what the light leaves open, the worst first; then
what another fit of the same photograph mends."""

_MORE_LIGHT: frozenset[Topic] = frozenset({"gloss", "shadow", "uncertain", "grazing"})
"""More light, or a second photograph: one of them says it."""

ANOTHER_FIT: frozenset[Topic] = frozenset({"dark-middle", "clamped"})
"""Another constraint on the same photograph: one of them says it."""


def improvements(doubted: Iterable[Topic], gaps: Sequence[Gap]) -> list[Topic]:
    """What to act on, what helps most first.

    doubted  topics of the warnings, and of what keeps the result from being good
    gaps     of the light
    """
    found = [topic for topic in _ORDER if topic in {*doubted, *gaps}]
    for same in (_MORE_LIGHT, ANOTHER_FIT):
        said_before = [topic for topic in found if topic in same][1:]
        found = [topic for topic in found if topic not in said_before]
    return [topic for topic in found if ADVICE[topic].actions][:MOST]


def sentence(topic: Topic, tried: Collection[str]) -> str:
    """What to do, as a sentence, without options that were tried; empty where nothing is left."""
    clauses = [clause for clause in ADVICE[topic].actions if not any(f"`{option}`" in clause for option in tried)]
    if not clauses:
        return ""
    text = ", or ".join(filter(None, ("; ".join(clauses[:-1]), clauses[-1])))
    return f"{text[0].upper()}{text[1:]}."
