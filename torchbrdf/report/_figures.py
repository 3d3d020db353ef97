"""The report's figures: pictures as inline PNG, curves as inline SVG. Strings of HTML, nothing from outside."""

import base64
from collections.abc import Sequence
from html import escape
from math import ceil, cos, floor, log10, pi, radians, sin

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from torchbrdf.brdf import GRID, MerlTable, cell_centres
from torchbrdf.images import DISPLAY_GAMMA, png_bytes

SURROUND = 0.46
"""Display value of the grey around pictures: 18 % reflectance, as on a grey card."""

CHANNEL_COLOURS = ("#c8372d", "#2a8c4a", "#2b62b8")
_CHANNEL_WIDTHS = (2.6, 1.7, 0.9)
"""Red is drawn first and widest, so that all three stay visible where they coincide."""

DIVERGING = ((0.02, 0.19, 0.38), (0.26, 0.58, 0.76), (0.97, 0.97, 0.97), (0.84, 0.38, 0.30), (0.40, 0.0, 0.12))
"""Display colours from -scale over 0 to +scale."""

SEQUENTIAL = ((0.97, 0.97, 0.95), (0.99, 0.85, 0.55), (0.93, 0.55, 0.25), (0.70, 0.20, 0.15), (0.35, 0.0, 0.10))
"""Display colours from 0 to the scale."""


THETA_I_DEG = (0.0, 30.0, 60.0, 75.0)
"""Of the light of polar plots."""


def gradient_css(colours: Sequence[tuple[float, float, float]]) -> str:
    """Display colours at equal distances, such as DIVERGING, as a CSS gradient, left to right."""
    stops = (f"rgb({', '.join(str(round(255 * c)) for c in colour)})" for colour in colours)
    return f"linear-gradient(to right, {', '.join(stops)})"


def on_grey(image: Tensor, exposure: float, shown: Tensor, shape: Tensor) -> Tensor:
    """Linear radiance (3, H, W) to show at `exposure`: the neutral surround where `shown` is False.

    shown, shape  (1, H, W) bool. Pixels that the silhouette cuts lie outside `shape`; they continue their
    neighbours, so that a picture clipped to the silhouette has no rim of another colour.
    """
    values, known = torch.where(shown, image.float(), 0.0), shown.clone()
    for _ in range(2):
        share = avg_pool2d(known.float(), 3, 1, 1)
        blurred = avg_pool2d(values, 3, 1, 1) / share.clamp_min(1e-6)
        grown = (share > 0) & ~known & ~shape
        values, known = torch.where(grown, blurred, values), known | grown
    return torch.where(known, values, SURROUND**DISPLAY_GAMMA / exposure)


def spread_map(share: Tensor, scale: float, shown: Tensor) -> Tensor:
    """Linear colours (3, H, W) of shares (1, H, W) from 0 (near white) to `scale` (dark); the surround elsewhere."""
    return torch.where(shown, _between(SEQUENTIAL, (share / scale).clamp(0, 1)), SURROUND) ** DISPLAY_GAMMA


def _between(stops: Sequence[tuple[float, float, float]], position: Tensor) -> Tensor:
    """Display colours (3, H, W) at positions (1, H, W) of 0 to 1 between stops at equal distances."""
    colours = torch.tensor(stops, dtype=torch.float32)
    place = position.float() * (len(colours) - 1)
    lower = place.floor().clamp_max(len(colours) - 2).long()
    return torch.lerp(colours[lower[0]], colours[lower[0] + 1], (place - lower)[0, ..., None]).movedim(-1, 0)


def signed_map(difference: Tensor, scale: float, shown: Tensor) -> Tensor:
    """Linear colours (3, H, W) of a signed scalar (1, H, W): blue below, red above, near white at 0."""
    position = ((difference / scale).clamp(-1, 1) + 1) / 2
    return torch.where(shown, _between(DIVERGING, position), SURROUND) ** DISPLAY_GAMMA


def picture(image: Tensor, alt: str, exposure: float = 1.0, kind: str = "") -> str:
    """An <img> of linear radiance (3, H, W), tone mapped, with its bytes inside; kind is a CSS class."""
    data = base64.b64encode(png_bytes(image, exposure)).decode()
    _, height, width = image.shape
    return (
        f'<img class="{kind}" src="data:image/png;base64,{data}" width="{width}" height="{height}" alt="{escape(alt)}">'
    )


def light_plan(angle_deg: float) -> str:
    """A plan of ball, camera (below) and directional light, seen from above (+Y)."""
    x, y = sin(radians(angle_deg)), cos(radians(angle_deg))
    return (
        f'<svg class="plan" viewBox="-24 -24 48 62" role="img" aria-label="from above: camera below the ball, '
        f'light at {angle_deg:g} degrees"><circle r="9" class="ball"/>'
        '<path d="M-5 37 L5 37 L0 28 Z" class="camera"/>'
        f'<line x1="{19 * x:.1f}" y1="{19 * y:.1f}" x2="{11 * x:.1f}" y2="{11 * y:.1f}" class="ray"/>'
        f'<circle cx="{19 * x:.1f}" cy="{19 * y:.1f}" r="4" class="lamp"/></svg>'
    )


def plane_of_incidence(table: MerlTable, theta_i_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """f_r in the plane of incidence: theta_o in degrees (m,), positive on the mirror side, and f_r (m, 3)."""
    near_mirror = theta_i_deg + 40 * np.linspace(-1, 1, 161) ** 3
    theta_o = np.union1d(np.linspace(-89, 89, 179), near_mirror[np.abs(near_mirror) <= 89])
    angle_i, angle_o = radians(theta_i_deg), torch.from_numpy(np.radians(theta_o))
    w_i = torch.tensor([-sin(angle_i), 0.0, cos(angle_i)], dtype=torch.float64)
    w_o = torch.stack([torch.sin(angle_o), torch.zeros_like(angle_o), torch.cos(angle_o)], dim=-1)
    return theta_o, table.lookup(w_i, w_o, interpolation="linear").numpy()


def log_range(values: np.ndarray) -> tuple[int, int]:
    """Decades (low, high) that hold positive values, at most seven: what lies below is drawn at the bottom."""
    positive = values[values > 0]
    if not len(positive):
        return -1, 0
    high = ceil(log10(float(positive.max())) + 1e-9)
    low = floor(log10(float(np.quantile(positive, 0.02))) - 0.5)
    return max(min(low, high - 1), high - 7), high


def polar_plot(
    table: MerlTable, theta_i_deg: float, decades: tuple[int, int], reference: MerlTable | None = None
) -> str:
    """f_r over theta_o in the plane of incidence, R, G, B; the logarithm of f_r is the radius.

    reference  another table, of which the mean of R, G, B is drawn in dashes
    """
    low, high = decades
    reach = 100.0
    theta_o, f_r = plane_of_incidence(table, theta_i_deg)

    def curve(values: np.ndarray) -> "zip[tuple[float, float]]":
        radius = reach * (np.log10(np.maximum(values, 10.0**low)) - low) / (high - low)
        return zip(radius * np.sin(np.radians(theta_o)), -radius * np.cos(np.radians(theta_o)), strict=True)

    parts = [f'<line x1="{-reach}" y1="0" x2="{reach}" y2="0" class="axis"/>']
    labelled = 1 if high - low < 5 else 2 if high - low < 8 else 3
    for decade in range(low + 1, high + 1):
        r = reach * (decade - low) / (high - low)
        parts.append(f'<path d="M{-r:.1f} 0 A{r:.1f} {r:.1f} 0 0 1 {r:.1f} 0" class="grid"/>')
        if (high - decade) % labelled == 0:
            parts.append(f'<text x="{-r:.1f}" y="10" class="tick middle">{_power(decade)}</text>')
    for angle in (-60, -30, 0, 30, 60):
        x, y = sin(radians(angle)), -cos(radians(angle))
        parts.append(f'<line x1="0" y1="0" x2="{reach * x:.1f}" y2="{reach * y:.1f}" class="grid"/>')
    x, y = -sin(radians(theta_i_deg)), -cos(radians(theta_i_deg))
    parts.append(
        f'<line x1="{116 * x:.1f}" y1="{116 * y:.1f}" x2="{104 * x:.1f}" y2="{104 * y:.1f}" class="ray"/>'
        f'<circle cx="{118 * x:.1f}" cy="{118 * y:.1f}" r="3.5" class="lamp"/>'
        f'<line x1="0" y1="0" x2="{-reach * x:.1f}" y2="{reach * y:.1f}" class="mirror"/>'
    )
    for channel in range(3):
        parts.append(_polyline(curve(f_r[:, channel]), CHANNEL_COLOURS[channel], _CHANNEL_WIDTHS[channel]))
    if reference is not None:
        parts.append(_polyline(curve(plane_of_incidence(reference, theta_i_deg)[1].mean(1)), "#444", 0.9, "3 2"))
    label = f"polar plot of f_r in the plane of incidence, light at {theta_i_deg:g} degrees from the normal"
    return f'<svg class="polar" viewBox="-126 -126 252 140" role="img" aria-label="{label}">{"".join(parts)}</svg>'


def theta_h_curve(table: MerlTable) -> np.ndarray:
    """(90, 3): f_r over theta_h in the first row of theta_d (0.5 degrees), mean over phi_d."""
    return table.filled.reshape(*GRID, 3)[:, 0].mean(1).cpu().numpy()


def theta_h_plot(
    found: np.ndarray, others: Sequence[np.ndarray], band: tuple[np.ndarray, np.ndarray] | None = None
) -> str:
    """f_r over theta_h at theta_d = 0 on a log axis: the result in R, G, B, others in grey.

    found, others  (90, 3), see `theta_h_curve`
    band           lower and upper bound (90, 3), drawn as an area
    """
    width, height, left, bottom = 640.0, 250.0, 46.0, 30.0
    shown = [found, *others] if band is None else [found, band[1], *others]
    low, high = log_range(np.concatenate(shown))
    theta_h = cell_centres()[0].ravel().numpy()

    def across(angle: np.ndarray | float) -> np.ndarray:
        return left + (width - left - 12) * np.sqrt(np.asarray(angle) * (2 / pi))

    def up(f_r: np.ndarray | float) -> np.ndarray:
        share = (np.log10(np.maximum(f_r, 10.0**low)) - low) / (high - low)
        return height - bottom - (height - bottom - 10) * share

    parts = []
    for decade in range(low, high + 1):
        y = float(up(10.0**decade))
        parts.append(f'<line x1="{left}" x2="{width - 12}" y1="{y:.1f}" y2="{y:.1f}" class="grid"/>')
        parts.append(f'<text x="{left - 6}" y="{y + 3.5:.1f}" class="tick end">{_power(decade)}</text>')
    for angle in (0, 1, 2, 5, 10, 20, 30, 45, 60, 90):
        x = float(across(radians(angle)))
        parts.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="10" y2="{height - bottom}" class="grid"/>')
        parts.append(f'<text x="{x:.1f}" y="{height - bottom + 14}" class="tick middle">{angle}°</text>')
    for channel in range(3 if band is not None else 0):
        lower, upper = (np.column_stack([across(theta_h), up(bound[:, channel])]) for bound in band or ())
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in np.concatenate([upper, lower[::-1]]))
        parts.append(f'<polygon points="{path}" fill="{CHANNEL_COLOURS[channel]}" class="band"/>')
    for other in others:
        parts.append(_polyline(zip(across(theta_h), up(other.mean(1)), strict=True), "#9a9a9a", 1.0, "5 3"))
    for channel in range(3):
        points = zip(across(theta_h), up(found[:, channel]), strict=True)
        parts.append(_polyline(points, CHANNEL_COLOURS[channel], _CHANNEL_WIDTHS[channel]))
    label = "f_r against theta_h at theta_d = 0, logarithmic"
    return (
        f'<svg class="curve" viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{label}">{"".join(parts)}</svg>'
    )


def bar(value: float, largest: float, colour: str) -> str:
    """A signed bar about a centre line, and its value."""
    length = 50 * abs(value) / largest if largest > 0 else 0.0
    start = 50.0 if value >= 0 else 50 - length
    number = f"{round(value, 3) + 0.0:+.3f}".replace("-", "−")
    return (
        '<svg class="bar" viewBox="0 0 100 10" preserveAspectRatio="none" aria-hidden="true">'
        f'<rect x="{start:.2f}" y="1" width="{length:.2f}" height="8" fill="{colour}"/>'
        f'<line x1="50" x2="50" y1="0" y2="10" class="axis"/></svg><span class="number">{number}</span>'
    )


def _power(decade: int) -> str:
    if -2 <= decade <= 3:
        return f"{10.0**decade:g}"
    return "10" + str(decade).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _polyline(points: "zip[tuple[float, float]]", colour: str, width: float, dashes: str = "") -> str:
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    dashed = f' stroke-dasharray="{dashes}"' if dashes else ""
    stroke = f'stroke="{colour}" stroke-width="{width}"{dashed} stroke-linejoin="round"'
    return f'<polyline points="{path}" fill="none" {stroke}/>'
