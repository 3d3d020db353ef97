"""The simulated photograph of an embedded material that `demo` and `live` recover."""

import torch

from torchbrdf.brdf import MerlTable
from torchbrdf.light import LightProbe
from torchbrdf.photograph import Observation
from torchbrdf.rendering import render
from torchbrdf.view import SphereView

MATERIAL = "gold-metallic-paint2"
SIZE = 64
NOISE = 0.01
"""Standard deviation of the simulated photograph's noise, relative to each pixel."""


def photographed(material: MerlTable, probe: LightProbe) -> Observation:
    """A simulated photograph of a ball, with noise."""
    view = SphereView(SIZE)
    clean = render(material, probe, view)
    noise = torch.randn(clean.shape, dtype=torch.float32, generator=torch.Generator().manual_seed(0))
    return Observation(clean * (1 + NOISE * noise), view.mask)
