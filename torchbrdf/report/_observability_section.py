"""The report's section on what the light and the view can tell at all: a map of cells, and a verdict."""

from html import escape

from torchbrdf.estimation import PHI_D, Observability
from torchbrdf.report.page import section

_DARK, _BRIGHT = (38, 38, 60), (250, 214, 92)
"""Display colours of a cell of which nothing, and everything, is removed."""

_CELL = 13
_LEFT, _TOP = 46, 8


def observability_section(found: Observability) -> str:
    """HTML of the verdict, the degrees of freedom, and where a library was given the map of cells."""
    rows = "".join(
        f"<tr><td>class {j}</td><td>{freedom:.1f}</td></tr>" for j, freedom in enumerate(found.freedom.tolist())
    )
    table = (
        "<table><thead><tr><th></th><th>degrees of freedom</th></tr></thead><tbody>"
        f"{rows}<tr><td>whole library</td><td>{found.whole:.1f}</td></tr></tbody></table>"
    )
    about = (
        f"<p>How many numbers about a material, per colour channel, stand out of {found.noise:.1%} noise if materials "
        "are like the library’s.</p>"
    )
    parts = [f'<p class="verdict">This light and view: {escape(found.verdict)}.</p>']
    picture = f'<div><div class="row">{heat_map(found)}</div></div>' if found.seen is not None else ""
    parts.append(f'<div class="row">{picture}<div>{about}{table}</div></div>')
    if found.seen is not None:
        parts.append(
            f'<p class="note">Cells of the BRDF at φ<sub>d</sub> = {PHI_D}°: the share of what is open about each that '
            "a photograph under this light from this view removes. Bright is determined, dark is the library’s guess. "
            "A cell may be bright that no light reaches: the library’s materials go together there. Grey lies below "
            "the horizon. θ<sub>h</sub> is spaced as in MERL’s grid, the highlight is at the top.</p>"
        )
    return section("What this light can tell", *parts)


def heat_map(found: Observability) -> str:
    """The cells as inline SVG: theta_h downwards, theta_d to the right."""
    if found.seen is None:
        raise ValueError("no cells to draw; ask for the observability with library=...")
    height, width = found.seen.shape
    cells = []
    for i, row in enumerate(found.seen.tolist()):
        for j, share in enumerate(row):
            place = f'x="{_LEFT + _CELL * j}" y="{_TOP + _CELL * i}" width="{_CELL}" height="{_CELL}"'
            cells.append(f'<rect {place} fill="{_colour(share)}"/>')
    bottom = _TOP + _CELL * height
    labels = [
        f'<text class="end" x="{_LEFT - 5}" y="{_TOP + _CELL * i + 10}">{found.theta_h[i]:.0f}°</text>'
        for i in range(0, height, 4)
    ]
    labels += [
        f'<text class="middle" x="{_LEFT + _CELL * j + _CELL / 2}" y="{bottom + 13}">{found.theta_d[j]:.0f}°</text>'
        for j in range(0, width, 4)
    ]
    labels.append(f'<text x="2" y="{_TOP + _CELL * height / 2}">θh</text>')
    labels.append(f'<text class="middle" x="{_LEFT + _CELL * width / 2}" y="{bottom + 27}">θd</text>')
    scale = _LEFT + _CELL * width + 24
    for step in range(11):
        y = _TOP + _CELL * (10 - step)
        cells.append(f'<rect x="{scale}" y="{y}" width="{_CELL}" height="{_CELL}" fill="{_colour(step / 10)}"/>')
        if step % 5 == 0:
            labels.append(f'<text x="{scale + _CELL + 5}" y="{y + 10}">{step * 10} %</text>')
    view_box = f"0 0 {scale + 60} {bottom + 32}"
    label = f'aria-label="share of each cell that is determined; {escape(found.verdict)}"'
    size = f'width="{scale + 60}" height="{bottom + 32}"'
    return f'<svg viewBox="{view_box}" {size} role="img" {label}>{"".join(cells)}{"".join(labels)}</svg>'


def _colour(share: float) -> str:
    if share != share:
        return "#d4d4d4"
    share = min(max(share, 0.0), 1.0)
    return "#" + "".join(f"{round(a + share * (b - a)):02x}" for a, b in zip(_DARK, _BRIGHT, strict=True))
