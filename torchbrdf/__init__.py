"""Measured-quality BRDFs from one photograph of a sphere under a known light probe."""

import os

# Read when torch is first imported. By default its idle threads spin, and take the cores from Mitsuba's threads and
# from other processes: on a busy machine that made the basis images eight times slower.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from torchbrdf.basis_images import BasisImages
from torchbrdf.classes import MaterialClasses
from torchbrdf.directional import render_directional
from torchbrdf.estimator import BRDFEstimator
from torchbrdf.images import read_image, read_mask, write_image
from torchbrdf.library import MaterialLibrary
from torchbrdf.merl import MerlTable
from torchbrdf.mitsuba_backend.mesh_view import Camera, MeshView
from torchbrdf.probe import LightProbe
from torchbrdf.reconstruction import Reconstruction
from torchbrdf.transport import render, render_basis
from torchbrdf.view import NormalMapView, SphereView, View

__all__ = [
    "BRDFEstimator",
    "BasisImages",
    "Camera",
    "LightProbe",
    "MaterialClasses",
    "MaterialLibrary",
    "MerlTable",
    "MeshView",
    "NormalMapView",
    "Reconstruction",
    "SphereView",
    "View",
    "read_image",
    "read_mask",
    "render",
    "render_basis",
    "render_directional",
    "write_image",
]

__version__ = "0.2.0"
