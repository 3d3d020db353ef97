"""The report's section on its warnings: each as it was said, what it means, and what to do."""

from collections.abc import Sequence
from html import escape

from torchbrdf.report.advice import ADVICE, Topic, marked
from torchbrdf.report.evidence import Evidence
from torchbrdf.report.page import section


def warnings_section(evidence: Evidence, acts: Sequence[Topic]) -> list[str]:
    """HTML of the warnings and of what to act on; nothing where there is neither."""
    said = {doubt.topic: doubt.text for doubt in evidence.doubts}
    paragraphs = [_paragraph(topic, said.get(topic)) for topic in dict.fromkeys([*said, *acts])]
    noted = all(doubt.is_harmless for doubt in evidence.doubts)
    title = f"What the {'notes' if noted else 'warnings'} mean" if said else "What would help, and why"
    return [section(title, *paragraphs)] if paragraphs else []


def _paragraph(topic: Topic, said: str | None) -> str:
    advice = ADVICE[topic]
    warning = "" if said is None else f'<div class="caution" role="note"><p>{escape(said)}</p></div>'
    return (
        f'<h3 id="{advice.anchor}">{advice.title}</h3>{warning}<p>{marked(advice.meaning)}</p>'
        f'<p>{marked(advice.remedy)} <span class="soft">In the documentation: {escape(advice.heading)}.</span></p>'
    )
