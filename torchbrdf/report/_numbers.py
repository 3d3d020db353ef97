"""The report's section on the numbers behind its first screen."""

from math import isfinite

from torchbrdf.report import grade as limits
from torchbrdf.report.doubts import (
    LARGE_CLAMPED_SHARE,
    LARGE_RESIDUAL,
    LARGE_SPREAD,
    OSCILLATION,
    SMALL_MARGIN,
    SMALL_PROBABILITY,
)
from torchbrdf.report.evidence import Evidence
from torchbrdf.report.page import section


def numbers_section(evidence: Evidence) -> str:
    """HTML of what was measured, of the grade's limits, and of what no number tells."""
    found, best, second = evidence.found, evidence.best, evidence.runner_up
    explained = f"explains the photograph to within <b>{found.error:.2%}</b> (relative RMS error)."
    if evidence.averaged:
        sentences = [f"The result {explained}"]
        if second is not None and best.probability is not None:
            sentences.append(
                f"The most probable class is {best.index} ({best.probability:.0%}); the result averages the classes, "
                "the whole library and neighbourhoods in it, by what the photograph says for each."
            )
        if evidence.spread is not None:
            sentences.append(f"Under another light its picture is uncertain by {evidence.spread.typical:.1%}.")
    elif second is None:
        sentences = [f"The only class {explained}"]
    else:
        times = f", {evidence.margin:.2f} times as much" if isfinite(evidence.margin) else ""
        sentences = [
            f"Class {found.index} {explained}",
            f"The second best, class {second.index}, leaves {second.error:.2%}{times}.",
        ]
    sentences.append(f"{found.clamped:.2%} of the table’s values were negative and are clamped at zero.")
    apart = (
        f"a class of {SMALL_PROBABILITY:.0%} or more, uncertain by at most {LARGE_SPREAD:.0%} under another light"
        if evidence.averaged
        else f"next at least {SMALL_MARGIN:g} times worse, sum of |weights| at most {OSCILLATION:g} times their sum"
    )
    return section(
        "The numbers",
        f'<p id="numbers">{" ".join(sentences)}</p>',
        f"<p><b>Good</b> leaves at most {limits.GOOD_RESIDUAL:.0%} of the photograph unexplained and has a standard "
        f"deviation of at most {limits.GOOD_SPREAD:.0%} under another light; <b>fair</b> at most "
        f"{limits.FAIR_RESIDUAL:.0%} and {limits.FAIR_SPREAD:.0%}; else <b>poor</b>. "
        "So are results with a warning on the shape, on the units, or on the uncertainty. The grade knows nothing of "
        "an exposure that differs between photograph and probe: the BRDF is off by the same factor.</p>",
        f'<p class="soft">There is no warning with a residual of at most {LARGE_RESIDUAL:.0%}, {apart}, '
        f"at most {LARGE_CLAMPED_SHARE:.0%} clamped.</p>",
        "<p><b>A small residual proves nothing.</b> Plain least squares always has the smallest, and often the worst "
        "BRDF. Look at the pictures under light that was not photographed: a spike in the centre, dark spots, rings "
        "around the highlight or a rim of another colour are marks of a wrong BRDF.</p>",
    )
