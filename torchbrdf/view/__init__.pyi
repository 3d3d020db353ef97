from .camera import (
    Camera as Camera,
    Framing as Framing,
)
from .mesh import (
    MESH_SUFFIXES as MESH_SUFFIXES,
    TriangleMesh as TriangleMesh,
)
from .mesh_view import MeshView as MeshView
from .normal_map import NormalMapView as NormalMapView
from .packing import (
    Frames as Frames,
    pack as pack,
    unpack as unpack,
)
from .ray_tracing import to_mitsuba_mesh as to_mitsuba_mesh
from .sphere import SphereView as SphereView
from .view import (
    SurfacePoints as SurfacePoints,
    View as View,
)
