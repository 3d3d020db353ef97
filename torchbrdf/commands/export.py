"""`torchbrdf export`: a table as a Mitsuba scene."""

import argparse

from torchbrdf.commands._findings import Findings
from torchbrdf.commands._options import add_light, add_output, add_shape, add_size, add_table

EXAMPLES = (
    "torchbrdf export result --probe probe.exr --view shape.ply -o scene",
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """What is shown, and where it is written."""
    add_table(parser)
    add_light(parser)
    add_shape(parser)
    add_size(parser, 256, "pixels along a side; default: %(default)s")
    add_output(parser, "folder for scene.xml, the files that it names, and render.py")


def run(options: argparse.Namespace, findings: Findings) -> int:
    """Write a BRDF on a shape under a light probe as a Mitsuba scene, ready to render and to edit."""
    from torchbrdf.commands._inputs import open_probe, open_table, open_view
    from torchbrdf.mitsuba_backend import RENDER_SCRIPT, export_scene

    table = open_table(options.brdf, options.primaries)
    written = export_scene(table, open_probe(options), open_view(options, options.size), options.output)
    findings.line(f"wrote {options.output}; `python {options.output / RENDER_SCRIPT}` renders it")
    findings.add_files(*written)
    return 0
