"""`torchbrdf demo`: the whole path on an embedded material that the library is not allowed to know."""

import argparse
from pathlib import Path

from torchbrdf.commands._options import add_output
from torchbrdf.files import writing_folder

PICTURE_SIZE = 192


def add_options(parser: argparse.ArgumentParser) -> None:
    """Where it goes."""
    add_output(parser, "folder for the results; default: torchbrdf-demo", Path("torchbrdf-demo"))


def run(options: argparse.Namespace) -> int:
    """Photograph a ball of one embedded material, recover it from the others, and compare under another light."""
    import torch

    from torchbrdf.brdf import MaterialLibrary
    from torchbrdf.commands._demonstration import MATERIAL, NOISE, photographed
    from torchbrdf.commands._reconstruction import fit, summary
    from torchbrdf.commands._results import write_results
    from torchbrdf.images import relative_rms, write_image
    from torchbrdf.light import LightProbe
    from torchbrdf.rendering import render
    from torchbrdf.view import SphereView

    whole = MaterialLibrary.default()
    library = whole.without(MATERIAL)
    probe = LightProbe.default()
    novel = probe.rotated(torch.diag(torch.tensor([-1.0, 1.0, -1.0])))  # half around the vertical
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
        write_results(folder, fitted, settings)
        large = SphereView(PICTURE_SIZE)
        expected = render(truth, novel, large)
        got = render(fitted.table, novel, large)
        write_image(folder / "novel_light.png", torch.cat([expected, got], dim=-1))
    print(summary(fitted))
    error = relative_rms(got, expected, large.mask)
    print(f"relative error under a light it was not observed under {error:.2%}")
    print(f"open {options.output}/report.html; novel_light.png shows the truth (left) and the reconstruction (right)")
    return 0
