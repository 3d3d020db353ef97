"""A comparison as one HTML page: pictures, slices, curves, differences, and a light to turn."""

import os
from collections.abc import Sequence
from html import escape
from math import isinf

import numpy as np

from torchbrdf.brdf import ALBEDO_DEG, delta_e_2000
from torchbrdf.files import writing
from torchbrdf.report._figures import (
    THETA_I_DEG,
    log_range,
    on_grey,
    picture,
    plane_of_incidence,
    polar_plot,
    spread_map,
)
from torchbrdf.report._pictures import light_picture, short_name, sphere_plate
from torchbrdf.report._slices import EXPLANATION, slice_exposures, slice_figure
from torchbrdf.report._turned_spheres import TurnedSpheres, compare_document
from torchbrdf.report.comparison import Comparison, percentage
from torchbrdf.report.page import plate, section
from torchbrdf.view import SphereView

_DELTA_E_SCALES = (2.0, 5.0, 10.0, 20.0, 50.0)


def write_comparison(path: str | os.PathLike[str], comparison: Comparison, title: str | None = None) -> None:
    """Write one HTML file that opens offline, with everything inside. The file is whole or absent."""
    names = comparison.names
    heading = title or f"{names[0]} and {names[1] if len(names) == 2 else f'{len(names) - 1} others'}"
    spheres = TurnedSpheres.of(names, comparison.shown, comparison.pictures.shape[-1])
    body = [
        f"<h1>{escape(heading)}</h1>",
        f'<p class="soft">BRDFs compared by torchbrdf; <b>{escape(names[0])}</b> is the reference.</p>',
        _warnings(comparison.warnings),
        _numbers(comparison),
        _lit(comparison),
        spheres.section(),
        _slices(comparison),
        _polars(comparison),
    ]
    with writing(path) as temporary:
        temporary.write_text(compare_document(heading, body), encoding="utf-8", errors="backslashreplace")


def _warnings(warnings: Sequence[str]) -> str:
    items = "".join(f"<li>{escape(text)}</li>" for text in warnings)
    return f'<div class="caution" role="note"><ul>{items}</ul></div>' if items else ""


def _numbers(comparison: Comparison) -> str:
    names = [escape(name) for name in comparison.names]
    rows = []
    for name, difference in zip(names[1:], comparison.differences, strict=True):
        shares = [*difference.cells.values(), difference.picture]
        cells = "".join(f"<td>{'∞' if isinf(share) else f'{share:.2%}'}</td>" for share in shares)
        rows.append(
            f"<tr><td>{name}</td>{cells}<td>{difference.delta_e_mean:.2f}</td><td>{difference.delta_e_95:.2f}</td></tr>"
        )
    head = "<th></th><th>L2</th><th>log</th><th>cube root</th><th>picture</th><th>ΔE mean</th><th>ΔE 95 %</th>"
    facts = []
    for name, table, albedo in zip(names, comparison.tables, comparison.albedo, strict=True):
        largest = float(table.values[table.valid].max())
        shown = f"{largest:.0f}" if 100 <= largest < 1e6 else f"{largest:.3g}"
        cells = "".join(f"<td>{float(value):.3f}</td>" for value in albedo)
        facts.append(f"<tr><td>{name}</td><td>{percentage(table.measured_share)}</td><td>{shown}</td>{cells}</tr>")
    angles = "".join(f"<th>at {angle}°</th>" for angle in ALBEDO_DEG)
    return section(
        f"How far from {comparison.names[0]}",
        _table(head, rows),
        '<p class="note">L2, log, cube root: |m(f cos θ<sub>i</sub>) − m(g cos θ<sub>i</sub>)| / '
        "|m(g cos θ<sub>i</sub>)| over the cells measured in both, in the measure dω<sub>i</sub> dω<sub>o</sub>, with "
        "m(x) = x, log(1 + x) or x<sup>1/3</sup>, f the BRDF and g the reference. L2 sees highlights and little else, "
        "the cube root what lies beside them. "
        "Picture: relative RMS difference of the spheres below. ΔE: CIEDE2000 of the spheres as shown "
        "(primaries of sRGB, white D65, clipped at white), mean and 95th percentile; 1 is about what is noticed.</p>",
        "<h3>Each by itself</h3>",
        _table(f"<th></th><th>measured</th><th>largest f<sub>r</sub>, 1/sr</th>{angles}", facts),
        '<p class="note">Measured: share of the cells above the horizon. At 0° to 75°: directional albedo, the share '
        "of the light from this angle that is reflected, mean of R, G, B.</p>",
    )


def _lit(comparison: Comparison) -> str:
    names, exposure, reference = comparison.names, comparison.exposure, comparison.pictures[0]
    view = SphereView(reference.shape[-1])
    shown = [
        sphere_plate(image, view, exposure, f"<b>{escape(name)}</b>")
        for name, image in zip(names, comparison.pictures, strict=True)
    ]
    largest = max(difference.delta_e_95 for difference in comparison.differences)
    scale = next((s for s in _DELTA_E_SCALES if s >= largest), _DELTA_E_SCALES[-1])
    ends = f'<div class="scale steps"></div><div class="ends"><span>0</span><span>{scale:g}</span></div>'
    maps = []
    for name, image in zip(names[1:], comparison.pictures[1:], strict=True):
        colours = spread_map(delta_e_2000(image, reference, exposure)[None], scale, view.mask)
        alt = f"CIEDE2000 of {name} from {names[0]}"
        inside = picture(on_grey(colours, 1.0, view.mask, view.mask), alt, 1.0, "middle disc")
        maps.append(plate(inside, f"ΔE, <b>{escape(name)}</b> from {escape(names[0])}{ends}"))
    rows = [[*shown, *maps]] if len(names) == 2 else [shown, maps]
    light = plate(light_picture(comparison.probe, "large"), "")
    about = (
        f'<div><p class="note"><b>The light</b>: {escape(short_name(comparison.probe))}. Its middle lies behind the '
        "camera, its left and right ends lie behind the ball.</p>"
        f'<p class="note">All spheres are shown with exposure × {exposure:.3g}: the 99th percentile of '
        f"{escape(names[0])} is white. Tone curve: gamma 2.2.</p></div>"
    )
    spheres = (_row(figures, len(names)) for figures in rows)
    return section("Under a light probe", *spheres, f'<div class="row below">{light}{about}</div>')


def _slices(comparison: Comparison) -> str:
    rows = [
        [
            slice_figure(table, f"<b>{escape(name)}</b>", exposure)
            for name, table in zip(comparison.names, comparison.shown, strict=True)
        ]
        for exposure in slice_exposures(comparison.shown[0])
    ]
    if len(comparison.names) == 2:
        rows = [[*rows[0], *rows[1]]]
    return section("Image slices", EXPLANATION, *(_row(figures) for figures in rows))


def _polars(comparison: Comparison) -> str:
    ranges = [
        log_range(np.concatenate([plane_of_incidence(table, angle)[1] for angle in THETA_I_DEG]))
        for table in comparison.tables
    ]
    decades = min(low for low, _ in ranges), max(high for _, high in ranges)
    reference = comparison.tables[0]
    rows = []
    for name, table in zip(comparison.names, comparison.tables, strict=True):
        figures = [
            f"<figure>{polar_plot(table, angle, decades, None if table is reference else reference)}<figcaption>"
            f"<b>{escape(name)}</b>, θ<sub>i</sub> = {angle:g}°</figcaption></figure>"
            for angle in THETA_I_DEG
        ]
        rows.append(_row(figures))
    return section(
        "In the plane of incidence",
        "<p>f<sub>r</sub> in 1/sr, without the cosine. The radius is the logarithm of f<sub>r</sub>, one ring a "
        f"decade, {10.0 ** decades[0]:g} and less in the centre. The light is the yellow dot, the straight dashed line "
        "the mirror direction.</p>",
        *rows,
        '<p class="key note"><span class="r"></span>R<span class="g"></span>G<span class="b"></span>B'
        f'<span class="first-line"></span>{escape(comparison.names[0])}, mean of R, G, B</p>',
    )


def _row(figures: Sequence[str], least: int = 0) -> str:
    return f'<div class="{"three" if max(len(figures), least) <= 3 else "four"}">{"".join(figures)}</div>'


def _table(head: str, rows: Sequence[str]) -> str:
    return f'<table class="numbers"><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table>'
