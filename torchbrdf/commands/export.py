"""`torchbrdf export`: a table as a Mitsuba scene."""

import argparse

from torchbrdf.commands.inputs import open_probe, open_view
from torchbrdf.merl import MerlTable
from torchbrdf.mitsuba_backend.export import RENDER, export_scene


def run(options: argparse.Namespace) -> int:
    """Write a BRDF on a shape under a light probe as a Mitsuba scene, ready to render and to edit."""
    table = MerlTable.open(options.brdf)
    export_scene(table, open_probe(options), open_view(options, options.size), options.output)
    print(f"wrote {options.output}; `python {options.output / RENDER}` renders it")
    return 0
