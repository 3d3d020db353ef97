"""The report's section on the classes: what the photograph would be if it were of one of them alone."""

from html import escape
from math import isfinite

from torchbrdf.images import exposure_for, stops_for
from torchbrdf.report._figures import on_grey, picture
from torchbrdf.report._pictures import ball, kind_of
from torchbrdf.report.evidence import Candidate, Evidence
from torchbrdf.report.page import section
from torchbrdf.view import SphereView, View


def classes_section(evidence: Evidence, view: View) -> str:
    """HTML of a table: the result where it is none of the candidates, and the candidate of every class."""
    shape = view.mask.cpu()
    found = evidence.found
    observed = exposure_for(evidence.photograph, evidence.used)
    novel = exposure_for(found.novel, SphereView(found.novel.shape[-1]).mask)
    frontal = stops_for(found.frontal)[1]
    badge = "likeliest" if evidence.averaged else "chosen"

    def row(candidate: Candidate) -> str:
        won = candidate.index == evidence.chosen
        ratio = candidate.error / found.error if found.error > 0 else float("nan")
        names = ", ".join(candidate.leading) or "none"
        sphere = SphereView(candidate.novel.shape[-1])
        what = "result" if candidate.index is None else f"class {candidate.index}"
        kind = "found" if candidate.index is None else "won" if won else ""
        shots = (
            picture(
                on_grey(candidate.fitted, observed, shape, shape), f"{what}: fit", observed, kind_of("small", view)
            ),
            ball(candidate.novel, sphere, novel, f"{what} under another light", "small"),
            ball(candidate.frontal, sphere, frontal, f"{what} under a directional light at 0 degrees", "small"),
        )
        cells = "".join(f'<td class="shot"><div class="plate">{shot}</div></td>' for shot in shots)
        times = "" if candidate is found or not isfinite(ratio) else f'<br><span class="soft">× {ratio:.2f}</span>'
        probable = ""
        if evidence.averaged:
            probable = f"<td>{'' if candidate.probability is None else f'{candidate.probability:.1%}'}</td>"
        return (
            f'<tr class="{kind}"><td>{what.capitalize()}<br>'
            f"{f'<span class=badge>{badge}</span>' if won else ''}</td>{cells}{probable}"
            f"<td>{candidate.error:.2%}{times}</td><td>{candidate.members}</td><td>{candidate.clamped:.2%}</td>"
            f"<td>{escape(names)}</td></tr>"
        )

    head = (
        "<tr><th></th><th>photograph’s light</th><th>another light</th><th>directional, 0°</th>"
        f"{'<th>proba-<br>bility</th>' if evidence.averaged else ''}<th>error on<br>photograph</th>"
        "<th>basis<br>BRDFs</th><th>clamped</th><th>largest weights</th></tr>"
    )
    about = (
        "Each class of materials was fitted by itself, with its own penalty by evidence. Probabilities are given that "
        "the material is of one of the classes. The result is none of these candidates: it averages them with fits by "
        "the whole library and by neighbourhoods in it."
        if evidence.averaged
        else "Each class of materials was fitted by itself; the smallest error |Yw − y| / |y| on the photograph wins."
    )
    shown = [found, *evidence.candidates] if evidence.averaged else evidence.candidates
    return section(
        "Every class’s candidate",
        f"<p>{about} All rows of a column share one exposure; another light is "
        f"{evidence.other_room}.</p>",
        f'<table class="classes"><thead>{head}</thead><tbody>{"".join(map(row, shown))}</tbody></table>',
    )
