"""`RayTracer`: what rays hit, traced by Mitsuba, with tensors in and out."""

from dataclasses import dataclass
from types import ModuleType

import numpy as np
import torch
from torch import Tensor

from torchbrdf.mitsuba_startup import is_vectorised, load_mitsuba
from torchbrdf.view.mesh import TriangleMesh


def to_mitsuba_mesh(mi: ModuleType, mesh: TriangleMesh, bsdf: object = None) -> object:
    """A `mitsuba.Mesh` with the same triangles and normals, and a loaded BSDF, in the variant that is set."""
    properties = mi.Properties()
    if bsdf is not None:
        properties["bsdf"] = bsdf
    shape = mi.Mesh(mesh.name, len(mesh.vertices), len(mesh.faces), properties, has_vertex_normals=True)
    arrays = mi.traverse(shape)
    arrays["vertex_positions"] = np.ravel(mesh.vertices)
    arrays["vertex_normals"] = np.ravel(mesh.normals)
    arrays["faces"] = np.ravel(mesh.faces).astype(np.uint32)
    arrays.update()
    return shape


@dataclass(frozen=True)
class Hits:
    """What rays hit first, all (3, N) float32 and 0 where a ray hits nothing.

    normals        interpolated between the vertices, unit length
    positions      in the mesh's units
    facet_normals  of the triangles, unit length
    """

    normals: Tensor
    positions: Tensor
    facet_normals: Tensor


class RayTracer:
    """Rays against one mesh.

    Origins and directions are (3, N) float32 on the CPU; directions have unit length.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        """Build the acceleration structure."""
        self._mi = load_mitsuba()
        self._scene = self._mi.load_dict({"type": "scene", "shape": to_mitsuba_mesh(self._mi, mesh)})

    def hits(self, origins: Tensor, directions: Tensor) -> Hits:
        """The first hit of every ray."""
        if not is_vectorised(self._mi):
            return self._hits_one_by_one(origins, directions)
        hit = self._scene.ray_intersect(self._rays(origins, directions))
        valid = hit.is_valid().torch().bool()
        found = (hit.sh_frame.n, hit.p, hit.n)
        return Hits(*(torch.where(valid, torch.stack([v[axis].torch() for axis in range(3)]), 0) for v in found))

    def blocked(self, origins: Tensor, directions: Tensor) -> Tensor:
        """(N,) bool: rays that hit something."""
        if origins.shape[1] == 0:  # Dr.Jit aborts the process where it is given no ray
            return torch.zeros(0, dtype=torch.bool)
        if not is_vectorised(self._mi):
            rays = zip(origins.T.tolist(), directions.T.tolist(), strict=True)
            return torch.tensor([self._scene.ray_test(self._mi.Ray3f(o, d)) for o, d in rays], dtype=torch.bool)
        return self._scene.ray_test(self._rays(origins, directions)).torch().bool()

    def _rays(self, origins: Tensor, directions: Tensor) -> object:
        mi = self._mi
        return mi.Ray3f(
            mi.Point3f(*(mi.Float(axis.contiguous()) for axis in origins)),
            mi.Vector3f(*(mi.Float(axis.contiguous()) for axis in directions)),
        )

    def _hits_one_by_one(self, origins: Tensor, directions: Tensor) -> Hits:
        found = np.zeros((len(origins.T), 9), np.float32)
        for row, (o, d) in enumerate(zip(origins.T.tolist(), directions.T.tolist(), strict=True)):
            hit = self._scene.ray_intersect(self._mi.Ray3f(o, d))
            if hit.is_valid():
                found[row] = *hit.sh_frame.n, *hit.p, *hit.n
        return Hits(*torch.from_numpy(found.T).split(3))
