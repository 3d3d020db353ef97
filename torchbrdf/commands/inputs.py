"""What several commands read: probes, libraries, views, and messages that name the file."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from torchbrdf.images import read_image
from torchbrdf.library import MaterialLibrary
from torchbrdf.mitsuba_backend.camera import Camera
from torchbrdf.mitsuba_backend.mesh import SUFFIXES as MESH_SUFFIXES
from torchbrdf.mitsuba_backend.mesh_view import MeshView
from torchbrdf.probe import LightProbe
from torchbrdf.view import NormalMapView, SphereView, View

_CAMERA = ("toward", "up", "target", "width")


def open_probe(options: argparse.Namespace) -> LightProbe:
    """The probe of `--probe`, `--probe-layout` and `--repair-probe`."""
    if options.probe == "default":
        return LightProbe.default()
    return LightProbe.open(options.probe, layout=options.probe_layout, repair=options.repair_probe)


def open_library(options: argparse.Namespace) -> MaterialLibrary:
    """The library of `--library`, else the embedded one."""
    return MaterialLibrary.default() if options.library is None else MaterialLibrary.from_merl(options.library)


def open_view(options: argparse.Namespace, size: int) -> View:
    """The view of `--view` and the camera's options.

    size  pixels along a side; a normal map brings its own
    """
    path = Path(options.view)
    if path.suffix.lower() in MESH_SUFFIXES:
        given = {key: getattr(options, key) for key in _CAMERA if getattr(options, key) is not None}
        return MeshView(path, size, Camera(**given, fov_deg=options.fov), shadows=not options.no_shadows)
    for key in (*_CAMERA, "no_shadows"):
        if getattr(options, key) not in (None, False):
            raise ValueError(f"--{key.replace('_', '-')} is for a mesh, and --view is {options.view}")
    if options.view == "sphere":
        return SphereView(size, options.fov)
    if options.fov is not None:
        raise ValueError(f"--fov is for a sphere or a mesh, and --view is {options.view}")
    with about(path):
        return NormalMapView(read_image(path))


@contextmanager
def about(path: Path) -> Iterator[None]:
    """Put the file's name before the message of a ValueError."""
    try:
        yield
    except ValueError as error:
        message = str(error)
        raise ValueError(message if str(path) in message else f"{path}: {message}") from None
