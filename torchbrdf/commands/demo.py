"""`torchbrdf demo`: the whole path on an embedded material that the library is not allowed to know."""

import argparse

import torch

from torchbrdf.commands.fit import fit, summary, write_results
from torchbrdf.files import writing_folder
from torchbrdf.images import write_image
from torchbrdf.library import MaterialLibrary
from torchbrdf.merl import MerlTable
from torchbrdf.metrics import relative_rms
from torchbrdf.photograph import Observation
from torchbrdf.probe import LightProbe
from torchbrdf.rendering import render
from torchbrdf.view import SphereView

MATERIAL = "gold-metallic-paint2"
SIZE = 64
PICTURE_SIZE = 192
PICTURE_SAMPLES = 1024
NOISE = 0.01
"""Standard deviation of the simulated photograph's noise, relative to each pixel."""


def run(options: argparse.Namespace) -> int:
    """Photograph a ball of one embedded material, recover it from the other 99, and compare under another light."""
    whole = MaterialLibrary.default()
    library = whole.without(MATERIAL)
    probe = LightProbe.default()
    novel = probe.rotated(_half_turn())
    truth = whole.table(MATERIAL)
    with writing_folder(options.output) as folder:
        observation = photographed(truth, probe)
        fitted = fit(observation, probe, library)
        write_image(folder / "photograph.exr", observation.image)
        settings = {
            "title": f"Demo: {MATERIAL}",
            "photograph": f"simulated: {MATERIAL}, {NOISE:.0%} noise",
            "light probe": probe.name,
        }
        write_results(folder, fitted, probe, library, settings)
        large = SphereView(PICTURE_SIZE)
        expected = render(truth, novel, large, PICTURE_SAMPLES, seed=2)
        got = render(fitted.table, novel, large, PICTURE_SAMPLES, seed=3)
        write_image(folder / "novel_light.png", torch.cat([expected, got], dim=-1))
    print(summary(fitted))
    error = relative_rms(got, expected, large.mask)
    print(f"relative error under a light it was not observed under {error:.2%}")
    print(f"open {options.output}/report.html; novel_light.png shows the truth (left) and the reconstruction (right)")
    return 0


def photographed(material: MerlTable, probe: LightProbe) -> Observation:
    """A simulated photograph of a ball, with noise."""
    view = SphereView(SIZE)
    clean = render(material, probe, view, seed=1)
    noise = torch.randn(clean.shape, generator=torch.Generator().manual_seed(0))
    return Observation(clean * (1 + NOISE * noise), view.mask)


def _half_turn() -> torch.Tensor:
    """A turn by 180 degrees about +Y."""
    return torch.diag(torch.tensor([-1.0, 1.0, -1.0]))
