"""`torchbrdf render`: a table under a light."""

import argparse

from torchbrdf.commands.inputs import open_probe
from torchbrdf.files import writing
from torchbrdf.images import check_image_suffix, write_image
from torchbrdf.merl import MerlTable
from torchbrdf.rendering import render
from torchbrdf.view import SphereView


def run(options: argparse.Namespace) -> int:
    """Render a sphere of a BRDF under a light probe, as .exr, .hdr or .png."""
    check_image_suffix(options.output)
    with writing(options.output) as temporary:
        probe = open_probe(options)
        table = MerlTable.open(options.brdf)
        image = render(table, probe, SphereView(options.size), options.samples)
        write_image(temporary, image * options.exposure if options.output.suffix.lower() == ".png" else image)
    print(f"wrote {options.output}")
    return 0
