from .baking import bake_basis as bake_basis
from .merl_plugin import (
    merl_bsdf as merl_bsdf,
    register_merl as register_merl,
)
from .scene_export import (
    RENDER_SCRIPT as RENDER_SCRIPT,
    export_scene as export_scene,
)
from .scenes import (
    Camera as Camera,
    HalfRenderings as HalfRenderings,
    MeshView as MeshView,
    MitsubaScene as MitsubaScene,
    MitsubaUnavailableError as MitsubaUnavailableError,
    load_mitsuba as load_mitsuba,
)
