"""`torchbrdf export`: a table as a Mitsuba scene."""

import argparse

from torchbrdf.commands.inputs import open_probe
from torchbrdf.merl import MerlTable
from torchbrdf.mitsuba_backend.export import RENDER, export_scene
from torchbrdf.mitsuba_backend.mesh_view import MeshView
from torchbrdf.view import SphereView, View

SPHERE = "sphere"


def run(options: argparse.Namespace) -> int:
    """Write a BRDF on a shape under a light probe as a Mitsuba scene, ready to render and to edit."""
    table = MerlTable.open(options.brdf)
    export_scene(table, open_probe(options), _view(options), options.output)
    print(f"wrote {options.output}; python {options.output / RENDER} renders it")
    return 0


def _view(options: argparse.Namespace) -> View:
    """The view of `--view` and `--size`."""
    return SphereView(options.size) if options.view == SPHERE else MeshView(options.view, options.size)
