"""`torchbrdf render`: a table under a light."""

import argparse

from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import (
    add_exposure,
    add_light,
    add_output,
    add_samples,
    add_size,
    add_table,
    check_exposure,
)
from torchbrdf.files import writing
from torchbrdf.progress import told_if_slow

EXAMPLES = (
    "torchbrdf render result --probe other.hdr -o other.png --size 512",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is rendered, and how well."""
    add_table(parser)
    add_light(parser)
    add_size(parser, 256, "pixels along a side; default: %(default)s")
    add_samples(parser, None, "a pixel, on average, of the sampled transport; default: the harmonic one, without")
    add_exposure(parser)
    add_output(parser, "X.exr, X.hdr, or X.png or X.jpg (gamma 2.2, clipped)")


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Render a sphere of a BRDF under a light probe, as .exr, .hdr, .png or .jpg."""
    from torchbrdf.commands._inputs import open_probe, open_table
    from torchbrdf.images import DISPLAY_SUFFIXES, check_image_suffix, exposure_for, with_rim, write_image
    from torchbrdf.rendering import render
    from torchbrdf.view import SphereView

    check_image_suffix(options.output)
    check_exposure(options.output, options.exposure)
    with writing(options.output) as temporary:
        probe = open_probe(options)
        table = open_table(options.brdf, options.primaries)
        view = SphereView(options.size)
        with told_if_slow(f"rendering {options.brdf}"):
            image = render(table, probe, view, options.samples)
        exposure, said = 1.0, ""
        if options.output.suffix.lower() in DISPLAY_SUFFIXES:
            exposure = exposure_for(image, view.mask) if options.exposure is None else options.exposure
            image = with_rim(image, view.mask, view.coverage)
            said = f", radiance times {exposure:.3g}"
        write_image(temporary, image * exposure, primaries=options.primaries)
    findings.line(f"wrote {options.output}{said}")
    findings.add(exposure=exposure)
    findings.add_files(options.output)
    return 0
