"""The report's pictures of balls and lights."""

import re
from html import unescape
from pathlib import PurePath

from torch import Tensor

from torchbrdf.images import exposure_for_light
from torchbrdf.light import LightProbe
from torchbrdf.report._figures import on_grey, picture
from torchbrdf.report.page import plate
from torchbrdf.view import SphereView, View

_PROBE_ROWS = 96


def kind_of(size: str, view: View) -> str:
    """CSS classes of a picture: its size, and whether it is clipped to a disc."""
    return f"{size} disc" if isinstance(view, SphereView) else size


def ball(image: Tensor, sphere: SphereView, exposure: float, alt: str, size: str) -> str:
    """A sphere (3, N, N) at an exposure."""
    return picture(on_grey(image, exposure, sphere.mask, sphere.mask), alt, exposure, kind_of(size, sphere))


def sphere_plate(image: Tensor, sphere: SphereView, exposure: float, caption: str) -> str:
    """A sphere on the neutral grey, with a caption (HTML)."""
    alt = unescape(re.sub(r"<svg.*</svg>|<[^>]*>", " ", caption)).strip()
    return plate(ball(image, sphere, exposure, f"sphere: {alt}", "middle"), caption)


def light_picture(probe: LightProbe, kind: str) -> str:
    """A small lat-long picture of a probe."""
    small = probe.resized(min(probe.height, _PROBE_ROWS)).radiance.cpu()
    return picture(small, f"{short_name(probe)}, lat-long", exposure_for_light(small.amax(0)), kind)


def short_name(probe: LightProbe) -> str:
    """Its name without the folders of a file."""
    return PurePath(probe.name.removeprefix("light probe ")).name
