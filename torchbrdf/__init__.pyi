from .alignment import Alignment as Alignment, align as align
from .analytic import (
    AnalyticFit as AnalyticFit,
    fit_analytic as fit_analytic,
    fit_analytic_batch as fit_analytic_batch,
    fit_analytic_to_image as fit_analytic_to_image,
)
from .brdf import MaterialLibrary as MaterialLibrary, MerlTable as MerlTable, read_table as read_table
from .camera import Ball as Ball, PinholeCamera as PinholeCamera
from .estimation import (
    BRDFEstimator as BRDFEstimator,
    MaterialClasses as MaterialClasses,
    Reconstruction as Reconstruction,
)
from .images import read_image as read_image, read_mask as read_mask, write_image as write_image
from .light import LightProbe as LightProbe
from .rendering import render as render, render_basis as render_basis, render_directional as render_directional
from .transport import BasisImages as BasisImages
from .transport.harmonic import HarmonicBasis as HarmonicBasis
from .view import (
    Camera as Camera,
    MeshView as MeshView,
    NormalMapView as NormalMapView,
    SphereView as SphereView,
    View as View,
)

__version__: str
