"""The report's section on what the photograph leaves open: standard deviations of the posterior as pictures."""

import torch
from torch import Tensor

from torchbrdf.report._figures import SEQUENTIAL, gradient_css, on_grey, picture, spread_map
from torchbrdf.report._pictures import kind_of
from torchbrdf.report.evidence import Evidence
from torchbrdf.report.page import plate, section
from torchbrdf.view import SphereView, View

NINETY = 1.645
"""Standard deviations on either side that hold 90 % of a Gaussian."""

_SCALES = (0.02, 0.05, 0.1, 0.25, 0.5, 1.0)


def spread_section(evidence: Evidence, view: View) -> str:
    """HTML of the relative standard deviation under the photograph's light and under another; needs a spread."""
    spread = evidence.spread
    if spread is None:
        raise ValueError("a fixed penalty has no posterior to show")
    sphere = SphereView(spread.novel.shape[-1])
    shape = view.mask.cpu()
    scale = spread_scale(spread.novel[sphere.mask])
    plates = [
        plate(
            picture(
                on_grey(spread_map(image, scale, mask), 1.0, mask, mask),
                f"relative standard deviation, {caption}",
                1.0,
                kind,
            ),
            f"<b>{caption[0].upper()}{caption[1:]}</b>: median {float(image[mask].median()):.1%}, "
            f"95th percentile {float(torch.quantile(image[mask].float(), 0.95)):.1%}.",
        )
        for image, mask, caption, kind in (
            (spread.observed, shape, "under the photograph’s light", kind_of("large", view)),
            (spread.novel, sphere.mask, "under another light", kind_of("large", sphere)),
        )
    ]
    key = (
        f'<div><div class="scale" style="background: {gradient_css(SEQUENTIAL)}"></div><div class="ends"><span>0</span>'
        f"<span>{scale / 2:.0%}</span><span>{scale:.0%} of the radiance and more</span></div>"
        '<p class="note">One standard deviation of the radiance over the radiance, red, green and blue together. The '
        "first picture is small wherever the photograph was fitted; the second is what matters: where it is red, the "
        "result rests on the library. It does not know of errors that all fits share: a misaligned probe, "
        "reflections of things near by, a material unlike all of the library.</p></div>"
    )
    return section("What the photograph leaves open", f'<div class="three">{"".join(plates)}{key}</div>')


def spread_scale(shares: Tensor) -> float:
    """The end of the colours of a map of these."""
    top = float(torch.quantile(shares.float(), 0.98))
    return next((scale for scale in _SCALES if scale >= top), _SCALES[-1])
