"""The report's first screen: is it good, what is it, what would make it better."""

from collections.abc import Collection, Iterable, Sequence
from html import escape
from math import pi

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from torchbrdf.estimation import Gap
from torchbrdf.images import exposure_for, tone_map
from torchbrdf.report._description import PEAK, Alike, Gloss, gloss_of, in_words, looks_clipped, most_alike
from torchbrdf.report._figures import SEQUENTIAL, gradient_css, on_grey, picture, spread_map, theta_h_curve
from torchbrdf.report._improvements import ANOTHER_FIT, improvements, sentence
from torchbrdf.report._pictures import ball, kind_of
from torchbrdf.report._spread import NINETY, spread_scale
from torchbrdf.report.advice import ADVICE, Topic, marked
from torchbrdf.report.evidence import Evidence
from torchbrdf.report.grade import shortcomings
from torchbrdf.report.page import plate
from torchbrdf.transport import BasisImages
from torchbrdf.view import SphereView, View

_SMALL = 40
"""Pixels along a side of the pictures of materials that look alike, at most."""

_UNLIKE_UNITS: tuple[Topic, ...] = ("no-unit", "reflectance")
"""Warnings that say themselves how photograph and probe stand to each other."""

_UNLIKE = 0.05
"""RMS of display values from which the nearest material is said to be unlike the photograph."""


def first_screen(
    evidence: Evidence, view: View, basis: BasisImages, acts: Sequence[Topic], tried: Collection[str]
) -> str:
    """HTML of the three answers and of the pictures.

    basis  of the photograph
    acts   what to act on, see `acts_on`
    tried  options that the result was made with
    """
    return (
        f'<div class="answers">\n{_good(evidence)}\n{_pictures(evidence, view)}\n<div class="halves">\n'
        f"{_what(evidence, view, basis)}\n{_better(acts, tried)}\n</div>\n</div>"
    )


def acts_on(evidence: Evidence, gaps: Sequence[Gap]) -> list[Topic]:
    """What would make the result better, what helps most first; gaps are the light's."""
    found = [doubt.topic for doubt in evidence.doubts]
    found += shortcomings(evidence.found.error, evidence.typical_spread)
    clipped = looks_clipped(evidence.photograph, evidence.found.fitted, evidence.used)
    return improvements([*found, "clipped"] if clipped else found, gaps)


def _good(evidence: Evidence) -> str:
    error, spread, grade = evidence.found.error, evidence.typical_spread, evidence.grade
    numbers = [f"{_rounded(error)} of the photograph unexplained"]
    if spread is not None:
        numbers.append(f"standard deviation under another light {_rounded(spread)}")
    warned = _titles(doubt.topic for doubt in evidence.doubts if not doubt.is_harmless)
    noted = _titles(doubt.topic for doubt in evidence.doubts if doubt.is_harmless)
    numbers.append(f"Warned of: {warned}" if warned else "no warning")
    if noted:
        numbers.append(f"Noted: {noted}")
    if all(doubt.topic not in _UNLIKE_UNITS for doubt in evidence.doubts):
        numbers.append("photograph and probe taken as in one unit")
    word = f'<b class="grade {grade.word.split()[0].lower()}">{grade.word}</b>'
    return (
        f'<div class="answer"><h2>Is it good?</h2><p class="said">{word} {grade.meaning}</p>'
        f'<p class="note">{" · ".join(numbers)} · <a href="#numbers">Limits</a></p></div>'
    )


def _titles(topics: Iterable[Topic]) -> str:
    """What they are called, each a link to what it means."""
    return ", ".join(f'<a href="#{ADVICE[topic].anchor}">{ADVICE[topic].title}</a>' for topic in topics)


def _pictures(evidence: Evidence, view: View) -> str:
    found, used, shape = evidence.found, evidence.used, view.mask.cpu()
    exposure, kind = exposure_for(evidence.photograph, used), kind_of("wide", view)
    sphere = SphereView(found.novel.shape[-1])
    shots = [
        (
            picture(on_grey(evidence.photograph, exposure, used, shape), "photograph", exposure, kind),
            "Photograph",
            ", grey where not used" if bool((shape & ~used).any()) else "",
        ),
        (picture(on_grey(found.fitted, exposure, shape, shape), "fit", exposure, kind), "Fit", ", the same light"),
        (
            ball(found.novel, sphere, exposure_for(found.novel, sphere.mask), "under another light", "wide"),
            "Under another light",
            f", {evidence.other_room}",
        ),
    ]
    if evidence.spread is not None:
        small, shares = SphereView(evidence.spread.novel.shape[-1]), evidence.spread.novel
        scale = spread_scale(shares[small.mask])
        key = (
            f'<span class="scale" style="background: {gradient_css(SEQUENTIAL)}"></span>'
            f'<span class="ends"><span>0</span><span>{scale:.0%} or more</span></span>'
        )
        shown = ball(spread_map(shares, scale, small.mask), small, 1.0, "relative standard deviation of that", "wide")
        shots.append((shown, "How uncertain", key))
    return f'<div class="four">{"".join(plate(shot, f"<b>{name}</b>{more}") for shot, name, more in shots)}</div>'


def _what(evidence: Evidence, view: View, basis: BasisImages) -> str:
    exposure = exposure_for(evidence.photograph, evidence.used)
    alike = most_alike(evidence.found.fitted, evidence.used, exposure, basis)
    shots = "".join(_thumbnail(one, view, exposure) for one in alike)
    gloss, albedo = gloss_of(evidence.found.table), evidence.albedo[0].tolist()
    names = in_words([f"<b>{escape(alike[0].name)}</b>", *(escape(one.name) for one in alike[1:])])
    sentences = [
        f"In this photograph it looks {_like(alike[0].difference)} {names}, shown in this order. The first’s pixels "
        f"differ by {alike[0].difference:.1%} of white (RMS).",
        f"{_gloss(evidence, gloss)}.",
        f"{_swatch(albedo)}Reflects {_shares(albedo)} of red, green, blue light from the front.",
        f"{_swatch(gloss.beside)}The colour beside its highlight.",
    ]
    if evidence.grade.word == "Poor":
        sentences.append('<span class="soft">So poor a result tells little of this for sure.</span>')
    text = "".join(f"<p>{sentence}</p>" for sentence in sentences)
    return f'<div class="answer"><h2>What is it?</h2><div class="alike">{shots}</div>{text}</div>'


def _gloss(evidence: Evidence, gloss: Gloss) -> str:
    """How glossy the result is, as far as 90 % intervals of its highlight, and of the top of that, tell."""
    spread = evidence.spread
    if spread is None:
        return str(gloss)
    table = evidence.found.table
    first = _first_told(theta_h_curve(table), spread.curve)
    told = gloss_of(table, first) if first else gloss
    brighter, deviation = spread.highlight.mean(1).tolist()
    least = sum(told.beside) / (3 * pi) if told.matt else brighter
    if NINETY * deviation > least:
        return "How glossy it is, this photograph does not tell"
    if first == 0 or (gloss.matt and told.matt):
        return str(told)
    if first is None:
        return "Glossy; how sharp its highlight is, this photograph does not tell"
    return f"{told}; how bright in its very middle, this photograph does not tell"


def _first_told(curve: np.ndarray, deviation: Tensor) -> int | None:
    """The first cell of a curve (90, 3) over theta_h from which on its deviation tells it; None where none does."""
    f_r, most = (torch.as_tensor(one).double().mean(1).unfold(0, PEAK, 1).mean(1) for one in (curve, deviation))
    told = torch.nonzero(NINETY * most <= f_r)
    return int(told[0]) if len(told) else None


def _like(difference: float) -> str:
    """How alike the nearest material is."""
    return "most like" if difference < _UNLIKE else "like no material of the library; the nearest are"


def _better(acts: Sequence[Topic], tried: Collection[str]) -> str:
    said_of = {topic: text for topic in acts if (text := sentence(topic, tried))}
    items = "".join(
        f'<li>{marked(text)} <a href="#{ADVICE[topic].anchor}">Why</a></li>' for topic, text in said_of.items()
    )
    said = f"<ol>{items}</ol>" if items else ""
    if ANOTHER_FIT.issuperset(said_of):  # of which no photograph needs to be taken anew
        text = (
            f"Nothing {'else ' if items else ''}stands out. What helps most is a second photograph, from another side "
            "or under another light: `torchbrdf observe --probe PROBE --suggest` says which, and `torchbrdf fit "
            "--same-material` takes both."
        )
        said += f"<p>{marked(text)}</p>"
    return f'<div class="answer"><h2>What would make it better?</h2>{said}</div>'


def _thumbnail(one: Alike, view: View, exposure: float) -> str:
    step = max(1, -(-max(one.image.shape[-2:]) // _SMALL))
    shape = view.mask.cpu()
    shown = avg_pool2d(on_grey(one.image, exposure, shape, shape).clamp(0, 1 / exposure), step, ceil_mode=True)
    return picture(shown, one.name, exposure, kind_of("thumb", view))


def _swatch(albedo: Sequence[float]) -> str:
    shown = (255 * tone_map(torch.tensor(albedo))).round().int().tolist()
    return f'<span class="swatch" style="background: rgb({shown[0]}, {shown[1]}, {shown[2]})"></span>'


def _shares(albedo: Sequence[float]) -> str:
    return ", ".join(f"{100 * share:.0f}" for share in albedo) + " %"


def _rounded(share: float) -> str:
    return f"{share:.1%}" if share < 0.0995 else f"{share:.0%}"
