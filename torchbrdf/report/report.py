"""The report of one reconstruction: a self-contained HTML page that shows whether the BRDF can be trusted.

A small residual proves nothing, so the page shows the BRDF where the photograph does not determine it: under other
light probes, under directional lights, and as curves.
"""

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from math import isfinite, log2

import numpy as np
import torch

from torchbrdf.estimation import Observability
from torchbrdf.files import writing
from torchbrdf.images import DEFAULT_SPACE, LUMINANCE, ColourSpace, exposure_for, stops_for
from torchbrdf.report._candidates import classes_section
from torchbrdf.report._figures import (
    CHANNEL_COLOURS,
    DIVERGING,
    THETA_I_DEG,
    bar,
    gradient_css,
    light_plan,
    log_range,
    on_grey,
    picture,
    plane_of_incidence,
    polar_plot,
    signed_map,
    theta_h_curve,
    theta_h_plot,
)
from torchbrdf.report._first_screen import acts_on, first_screen
from torchbrdf.report._numbers import numbers_section
from torchbrdf.report._observability_section import observability_section
from torchbrdf.report._pictures import kind_of, light_picture, short_name, sphere_plate
from torchbrdf.report._silhouette_section import Scene, silhouette_section
from torchbrdf.report._slices import EXPLANATION as SLICE_EXPLANATION, slice_exposures, slice_figure
from torchbrdf.report._spread import NINETY, spread_section
from torchbrdf.report._warnings_section import warnings_section
from torchbrdf.report.doubts import Doubt
from torchbrdf.report.evidence import TURN_DEG, Evidence, Subject, gather
from torchbrdf.report.grade import Grade
from torchbrdf.report.page import definitions, page, plate, section
from torchbrdf.view import SphereView, View

_SIZE = 128
_SAMPLES = 400
"""Pixels along a side of the spheres under light that was not observed, and samples a pixel, see `gather`."""

_N_WEIGHTS = 12
_MAP_SCALES = (0.05, 0.1, 0.25, 0.5, 1.0)
_LUMINANCE = torch.tensor(LUMINANCE)[:, None, None]


@dataclass(frozen=True)
class Verdict:
    """What a report says first: how good the result is, and what it warns of beside what was known."""

    grade: Grade
    doubts: list[Doubt]


def write_report(
    path: str | os.PathLike[str],
    subject: Subject,
    description: Mapping[str, str],
    *,
    observability: Observability | None = None,
    scene: Scene | None = None,
    tried: Collection[str] = (),
    known: Sequence[Doubt] = (),
    primaries: ColourSpace = DEFAULT_SPACE,
    size: int = _SIZE,
    samples: int = _SAMPLES,
) -> Verdict:
    """Write one HTML file that opens offline, with everything inside.

    subject      the reconstruction and what it was made from
    description  settings to list, name -> value; a "title" becomes the title of the page
    observability  what the light and the view can tell at all, for a section of its own
    scene        the whole photograph of a ball, for a section of its own
    tried        options of `torchbrdf fit` that need not be recommended, as the result was made with them
    known        what is doubtful of the capture, whatever came out
    primaries    the linear RGB of photograph, light and BRDF; pictures show it as a screen's, which the page says
    size         pixels along a side of the spheres under other light
    samples      a pixel, for candidates where the library's harmonic transport was not precomputed
    The file is whole or absent.
    """
    evidence, view = gather(subject, size, samples, known, primaries), subject.view
    settings = {key: str(value) for key, value in description.items()}
    title = settings.pop("title", "") or "BRDF from a photograph"
    acts = acts_on(evidence, () if observability is None else observability.gaps)
    body = [
        f"<h1>{escape(title)}</h1>",
        _colours(primaries),
        first_screen(evidence, view, subject.basis, acts, tried),
        _observed(evidence, view),
        *([] if scene is None else [silhouette_section(scene)]),
        _novel(evidence),
        *([] if evidence.spread is None else [spread_section(evidence, view)]),
        *([] if observability is None else [observability_section(observability)]),
        classes_section(evidence, view),
        _curves(evidence),
        _weights(evidence),
        *warnings_section(evidence, acts),
        numbers_section(evidence),
        _settings(settings, subject),
    ]
    with writing(path) as temporary:
        temporary.write_text(page(title, body), encoding="utf-8", errors="backslashreplace")
    return Verdict(evidence.grade, evidence.found_doubts)


def _colours(primaries: ColourSpace) -> str:
    """What to know of the colours of all pictures."""
    if primaries == DEFAULT_SPACE:
        return ""
    return (
        f'<p class="caution">Pictures show linear {primaries} as if it were a screen’s RGB, so their colours are not '
        "right: paler where the space is wider.</p>"
    )


def _observed(evidence: Evidence, view: View) -> str:
    found, used = evidence.found, evidence.used
    exposure = exposure_for(evidence.photograph, used)
    kind = kind_of("large", view)
    shape = view.mask.cpu()
    difference = ((found.fitted - evidence.photograph) * _LUMINANCE).sum(0, keepdim=True) * exposure
    spread = float(torch.quantile(difference[used].abs().float(), 0.99))
    scale = next((s for s in _MAP_SCALES if s >= spread), _MAP_SCALES[-1])
    unused = int((shape & ~used).sum())
    why = "the mask’s, and on the edge those that hold background" if isinstance(view, SphereView) else "the mask’s"
    left_out = f" {unused} pixels (grey) are left out: {why}." if unused else ""
    errors = ", ".join(
        f"{name} {error:.2%}" for name, error in zip("RGB", evidence.channel_errors, strict=True) if isfinite(error)
    )
    map_colours = signed_map(difference, scale, used)
    bar_ends = f"<span>−{scale:.0%}</span><span>0</span><span>+{scale:.0%} of white</span>"
    plates = [
        plate(
            picture(on_grey(evidence.photograph, exposure, used, shape), "the photograph", exposure, kind),
            f"<b>Photograph</b>, {used.shape[-1]} × {used.shape[-2]}.{left_out}",
        ),
        plate(
            picture(on_grey(found.fitted, exposure, shape, shape), "the fit under the same light", exposure, kind),
            f"<b>Fit</b>, same exposure. {errors}.",
        ),
        plate(
            picture(on_grey(map_colours, 1.0, used, shape), "signed difference, fit minus photograph", 1.0, kind),
            "<b>Fit − photograph</b>, luminance. Blue: the fit is darker; red: brighter."
            f'<div class="scale" style="background: {gradient_css(DIVERGING)}"></div>'
            f'<div class="ends">{bar_ends}</div>',
        ),
    ]
    stops = f"{log2(exposure):+.1f}".replace("-", "−")
    note = (
        f'<p class="note">Shown with exposure × {exposure:.3g} ({stops} stops): radiance {1 / exposure:.3g}, the 99th '
        "percentile of the photograph, is white; brighter pixels are clipped. Tone curve: gamma 2.2.</p>"
    )
    caption = f"<b>The light</b>, {escape(short_name(evidence.probes[0]))}."
    light = plate(light_picture(evidence.probes[0], "large"), caption)
    about = (
        '<div><p class="note">The middle of the picture of the light lies behind the camera, its left and right ends '
        f"lie behind the ball.</p>{note}</div>"
    )
    return section(
        "The photograph and its fit",
        f'<div class="three">{"".join(plates)}</div>',
        f'<div class="row below">{light}{about}</div>',
    )


def _novel(evidence: Evidence) -> str:
    sphere = SphereView(evidence.turned.shape[-1])
    probes = []
    for image, probe, caption in (
        (evidence.found.novel, evidence.probes[1], f"<b>Another light</b>, {evidence.other_room}"),
        (evidence.turned, evidence.probes[2], f"<b>The photograph’s light</b>, turned {TURN_DEG:.0f}° about +Y"),
    ):
        probes.append(sphere_plate(image, sphere, exposure_for(image, sphere.mask), caption))
        probes.append(plate(light_picture(probe, "middle"), "the light"))
    directional = []
    for angle, image in evidence.directional.items():
        where = "from the camera" if angle == 0 else "from behind, image right"
        for exposure, what in zip(stops_for(image), (where, "beside the highlight"), strict=True):
            caption = f"{light_plan(angle)}<b>Directional, {angle:g}°</b>, {what}<br>exposure × {_power(exposure)}"
            directional.append(sphere_plate(image, sphere, exposure, caption))
    note = (
        '<p class="note">Under the probes the 99th percentile of each picture is white. The directional lights have '
        "irradiance π: at exposure × 1 a white diffuse surface that faces the light just reaches white. Each is shown "
        "with two exposures, for the highlight and for what lies beside it; rings and steps in the second are the "
        "table’s cells, a degree wide. The angle turns the light about the vertical axis (+Y): 0° is light from the "
        "camera, 90° from image right.</p>"
    )
    rows = (f'<div class="four">{"".join(figures)}</div>' for figures in (probes, directional))
    return section("Under light that was not photographed", *rows, note)


def _power(exposure: float) -> str:
    """A power of two, for people."""
    return f"{exposure:g}" if exposure >= 1 else f"1/{1 / exposure:g}"


def _curves(evidence: Evidence) -> str:
    table = evidence.found.table
    samples = np.concatenate([plane_of_incidence(table, theta_i)[1] for theta_i in THETA_I_DEG])
    decades = log_range(samples)
    plots = "".join(
        f"<figure>{polar_plot(table, theta_i, decades)}<figcaption>θ<sub>i</sub> = {theta_i:g}°</figcaption></figure>"
        for theta_i in THETA_I_DEG
    )
    others = [theta_h_curve(other.table) for other in evidence.candidates if other is not evidence.found]
    key = "".join(
        f'<span style="border-color: {colour}"></span>{name}'
        for name, colour in zip("RGB", CHANNEL_COLOURS, strict=True)
    )
    what = "candidates of the classes" if evidence.averaged else "other classes"
    dashed = f'<span style="border-top: 1px dashed #777"></span>{what}, mean of R, G, B' if others else ""
    curve, band = theta_h_curve(table), None
    if evidence.spread is not None:
        reach = NINETY * evidence.spread.curve.numpy()
        band = np.maximum(curve - reach, 0.0), curve + reach
        dashed += '<span style="border-top: 9px solid #777; opacity: .3"></span>90 % interval'
    return section(
        "The BRDF",
        "<p>f<sub>r</sub> in 1/sr, without the cosine, in the plane of incidence. The radius is the logarithm of "
        f"f<sub>r</sub>, one ring a decade, {10.0 ** decades[0]:g} and less in the centre. The light is the yellow "
        "dot, the dashed line the mirror direction.</p>",
        f'<div class="polars">{plots}</div>',
        "<p>f<sub>r</sub> over θ<sub>h</sub> at θ<sub>d</sub> = 0 (light and camera in one direction); the axis is "
        "stretched towards the highlight as MERL’s grid is.</p>",
        theta_h_plot(curve, others, band),
        f'<p class="key note">{key}{dashed}</p>',
        SLICE_EXPLANATION,
        f'<div class="three">{"".join(slice_figure(table, "", stops) for stops in slice_exposures(table))}</div>',
    )


def _weights(evidence: Evidence) -> str:
    weights = evidence.weights
    strength = weights.abs().amax(1)
    largest = float(strength.max())
    rows = []
    for i in torch.argsort(strength, descending=True, stable=True)[:_N_WEIGHTS].tolist():
        if strength[i] == 0:
            break
        bars = "".join(f"<td>{bar(float(weights[i, c]), largest, CHANNEL_COLOURS[c])}</td>" for c in range(3))
        material = f'{escape(evidence.names[i // 3])} <span class="soft">{"RGB"[i % 3]}</span>'
        rows.append(f"<tr><td>{material}</td>{bars}</tr>")
    sums, sizes = weights.sum(0), weights.abs().sum(0)
    head = "<th>material and its channel</th><th>weight in R</th><th>weight in G</th><th>weight in B</th>"
    totals = "".join(f"<td>Σw {sums[c]:.2f}, Σ|w| {sizes[c]:.2f}</td>" for c in range(3))
    shown = len(rows)
    return section(
        "The largest weights",
        f"<p>{shown} of the {evidence.found.members} basis BRDFs with a weight. A basis BRDF is one channel of one "
        "material; the columns are the channels of the result.</p>",
        f'<table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}<tr class="soft"><td>all</td>{totals}</tr>'
        "</tbody></table>",
    )


def _settings(settings: Mapping[str, str], subject: Subject) -> str:
    basis = subject.basis
    made = {"materials": str(len(subject.library)), "basis images": basis.description}
    prints = {"library": basis.library, "light probe": basis.probe, "view": basis.view}
    return section("Settings and fingerprints", definitions({**settings, **made}), definitions(prints, "print"))
