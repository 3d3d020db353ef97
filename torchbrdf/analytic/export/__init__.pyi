from .formats import (
    FORMATS as FORMATS,
    format_of as format_of,
    native_fit as native_fit,
    write_binary as write_binary,
)
from .gltf import write_gltf as write_gltf
from .materialx import write_materialx as write_materialx
from .mitsuba import (
    mitsuba_bsdf as mitsuba_bsdf,
    write_mitsuba as write_mitsuba,
)
from .settings import SUFFIXES as SUFFIXES
