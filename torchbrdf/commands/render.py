"""`torchbrdf render`: a table under a light."""

import argparse

from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import add_light, add_output, add_samples, add_size, add_table, number
from torchbrdf.files import writing

EXAMPLES = (
    "torchbrdf render result --probe other.hdr -o other.png --size 512",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is rendered, and how well."""
    add_table(parser)
    add_light(parser)
    add_size(parser, 256, "pixels along a side; default: %(default)s")
    add_samples(parser, None, "a pixel, on average, of the sampled transport; default: the harmonic one, without")
    text = "factor on the radiance in a .png; default: the 99th percentile of the picture becomes white"
    parser.add_argument("--exposure", type=number(0), help=text)
    add_output(parser, "X.exr, X.hdr or X.png (gamma 2.2, clipped)")


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Render a sphere of a BRDF under a light probe, as .exr, .hdr or .png."""
    from torchbrdf.commands._inputs import open_probe, open_table
    from torchbrdf.images import check_image_suffix, exposure_for, write_image
    from torchbrdf.rendering import render
    from torchbrdf.view import SphereView

    check_image_suffix(options.output)
    with writing(options.output) as temporary:
        probe = open_probe(options)
        table = open_table(options.brdf)
        view = SphereView(options.size)
        image = render(table, probe, view, options.samples)
        exposure, said = 1.0, ""
        if options.output.suffix.lower() == ".png":
            exposure = exposure_for(image, view.mask) if options.exposure is None else options.exposure
            said = f", radiance times {exposure:.3g}"
        write_image(temporary, image * exposure, primaries=options.primaries)
    findings.line(f"wrote {options.output}{said}")
    findings.add(exposure=exposure)
    findings.add_files(options.output)
    return 0
