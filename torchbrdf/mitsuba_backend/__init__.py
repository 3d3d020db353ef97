"""Mitsuba 3 beside the transport of this package."""

from torchbrdf.camera import Camera
from torchbrdf.mitsuba_backend.baking import bake_basis
from torchbrdf.mitsuba_backend.export import export_scene
from torchbrdf.mitsuba_backend.merl_bsdf import merl_bsdf, register_merl
from torchbrdf.mitsuba_backend.mesh_view import MeshView
from torchbrdf.mitsuba_backend.scenes import HalfRenderings, MitsubaScene
from torchbrdf.mitsuba_startup import MitsubaUnavailableError, load_mitsuba

__all__ = [
    "Camera",
    "HalfRenderings",
    "MeshView",
    "MitsubaScene",
    "MitsubaUnavailableError",
    "bake_basis",
    "export_scene",
    "load_mitsuba",
    "merl_bsdf",
    "register_merl",
]
