"""Measured-quality BRDFs from one photograph of a sphere under a known light probe."""

import os

# libgomp reads it when torch is first imported. Idle threads of torch spin for long by default and take the cores
# from Mitsuba's threads and from other processes: basis images on two busy cores took 30 s and more instead of 7 s.
# Spinning shortly costs nothing on quiet ones (docs/mitsuba.md).
os.environ.setdefault("GOMP_SPINCOUNT", "5000")

from torchbrdf._version import __version__ as __version__
from torchbrdf.alignment import Alignment, align
from torchbrdf.analytic_fit import AnalyticFit, fit_analytic, fit_analytic_batch
from torchbrdf.analytic_image_fit import fit_analytic_to_image
from torchbrdf.basis_images import BasisImages
from torchbrdf.camera import Camera
from torchbrdf.classes import MaterialClasses
from torchbrdf.directional import render_directional
from torchbrdf.estimator import BRDFEstimator
from torchbrdf.harmonic_basis import HarmonicBasis
from torchbrdf.images import read_image, read_mask, write_image
from torchbrdf.library import MaterialLibrary
from torchbrdf.merl import MerlTable
from torchbrdf.mitsuba_backend.mesh_view import MeshView
from torchbrdf.probe import LightProbe
from torchbrdf.reconstruction import Reconstruction
from torchbrdf.rendering import render, render_basis
from torchbrdf.view import NormalMapView, SphereView, View

__all__ = [
    "Alignment",
    "AnalyticFit",
    "BRDFEstimator",
    "BasisImages",
    "Camera",
    "HarmonicBasis",
    "LightProbe",
    "MaterialClasses",
    "MaterialLibrary",
    "MerlTable",
    "MeshView",
    "NormalMapView",
    "Reconstruction",
    "SphereView",
    "View",
    "align",
    "fit_analytic",
    "fit_analytic_batch",
    "fit_analytic_to_image",
    "read_image",
    "read_mask",
    "render",
    "render_basis",
    "render_directional",
    "write_image",
]
