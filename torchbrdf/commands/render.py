"""`torchbrdf render`: a table under a light."""

import argparse

from torchbrdf.commands.inputs import open_probe
from torchbrdf.images import write_image
from torchbrdf.merl import MerlTable
from torchbrdf.transport import render
from torchbrdf.view import SphereView


def run(options: argparse.Namespace) -> int:
    """Render a sphere of a BRDF under a light probe, as .exr, .hdr or .png."""
    probe = open_probe(options)
    table = MerlTable.open(options.brdf)
    image = render(table, probe, SphereView(options.size))
    write_image(options.output, image * options.exposure if options.output.suffix.lower() == ".png" else image)
    print(f"wrote {options.output}")
    return 0
