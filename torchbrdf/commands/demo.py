"""`torchbrdf demo`: the whole path on an embedded material that the library is not allowed to know."""

import argparse
from pathlib import Path

from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import add_output
from torchbrdf.files import writing_folder
from torchbrdf.progress import told_if_slow

PICTURE_SIZE = 192

EXAMPLES = (
    "torchbrdf demo",
    "torchbrdf demo -o elsewhere",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Where it goes."""
    add_output(parser, "folder for the results; default: torchbrdf-demo", Path("torchbrdf-demo"))


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Photograph a ball of one embedded material, recover it from the others, and compare under another light."""
    import torch

    from torchbrdf.brdf import MaterialLibrary
    from torchbrdf.commands._demonstration import MATERIAL, NOISE, photographed
    from torchbrdf.commands._reconstruction import fit, result_record, summary, weights_record
    from torchbrdf.commands._results import write_results
    from torchbrdf.images import relative_rms, with_rim, write_image
    from torchbrdf.light import LightProbe
    from torchbrdf.rendering import render
    from torchbrdf.view import SphereView

    whole = MaterialLibrary.default()
    library = whole.without(MATERIAL)
    probe = LightProbe.default()
    novel = probe.rotated(torch.diag(torch.tensor([-1.0, 1.0, -1.0])))  # half around the vertical
    truth = whole.table(MATERIAL)
    with writing_folder(options.output) as folder:
        with told_if_slow("photographing a ball by simulation, and recovering its BRDF"):
            observation = photographed(truth, probe)
            fitted = fit(observation, probe, library)
        write_image(folder / "photograph.exr", observation.image)
        settings = {
            "title": f"Demo: {MATERIAL}",
            "photograph": f"simulated: {MATERIAL}, {NOISE:.0%} noise",
            "light probe": probe.name,
        }
        large = SphereView(PICTURE_SIZE)
        with told_if_slow("making the report, and pictures under another light"):
            write_results(folder, fitted, settings)
            expected = render(truth, novel, large)
            got = render(fitted.table, novel, large)
        pair = [with_rim(picture, large.mask, large.coverage) for picture in (expected, got)]
        write_image(folder / "novel_light.png", torch.cat(pair, dim=-1))
        names = sorted(path.name for path in folder.iterdir())
    findings.line(f"a simulated photograph of {MATERIAL}, recovered from the {len(library.names)} other materials")
    findings.line(summary(fitted))
    error = relative_rms(got, expected, large.mask)
    findings.line(f"relative error under a light it was not observed under {error:.2%}")
    shows = "novel_light.png shows the truth (left) and the reconstruction (right)"
    findings.line(f"open {options.output}/report.html; {shows}")
    findings.add(material=MATERIAL, **result_record(weights_record(fitted)), relative_error_under_novel_light=error)
    findings.add_files(*(options.output / name for name in names))
    return 0
