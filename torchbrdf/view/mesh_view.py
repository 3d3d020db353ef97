"""`MeshView`: a known shape of triangles before a camera, with the shadows that it casts on itself."""

import os
from functools import cached_property

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchbrdf.view.camera import Camera, Framing
from torchbrdf.view.mesh import TriangleMesh
from torchbrdf.view.ray_tracing import Hits, RayTracer
from torchbrdf.view.view import SurfacePoints, View

_FINEST = 16
"""Points along a side of a pixel at which rays are traced: the area of a pixel is the mean over them."""

_COARSEST = 4
_MOST_POINTS = 1 << 23
"""Beyond this many in all, pixels get fewer points, down to _COARSEST along a side; each takes 36 bytes."""

_RAYS = 1 << 20
"""Traced at once."""

_OFFSET = 1e-5
"""Shadow rays start this far above their facet, times the distance of the farthest vertex: a hundred roundings."""


class MeshView(View):
    """A mesh before a camera.

    path    .ply, .obj, .glb or .gltf file; its axes are those of the light probe
    size    pixels along a side of the square image
    camera  default: orthographic, along -Z, the mesh's bounding sphere touches the borders
    shadows trace whether a point sees the light; without, the shape is lit as if nothing were in the way

    Pixels that the silhouette cuts are outside the mask. Light that reflects twice is not simulated: that would
    not be linear in the BRDF. Traced by Mitsuba.
    """

    framing: Framing

    def __init__(
        self, path: str | os.PathLike[str], size: int, camera: Camera | None = None, shadows: bool = True
    ) -> None:
        """Read the mesh and find the pixels that it covers."""
        if size < 3 or size != int(size):
            raise ValueError(f"a view needs an image of at least 3 x 3 whole pixels, got size={size}")
        self.mesh = TriangleMesh.open(path)
        self.camera = camera or Camera()
        self.shadows = shadows
        self.framing = Framing.of_mesh(self.camera, self.mesh)
        self._n = int(size)
        self._fine = _FINEST
        while self._fine > _COARSEST and (self._n * self._fine) ** 2 > _MOST_POINTS:
            self._fine //= 2
        self.mask, self._points = self._trace_pixels()
        if not self.mask.any():
            low, high = self.mesh.vertices.min(0), self.mesh.vertices.max(0)
            low, high, target = (np.round(corner, 4).tolist() for corner in (low, high, self.framing.target.numpy()))
            raise ValueError(
                f"{path}: no pixel of the {size} x {size} image lies wholly on the outside of the mesh, which spans "
                f"{low} to {high}; check the camera (it looks at {target}), that the mesh is not inside out, "
                "or take more pixels"
            )

    def __repr__(self) -> str:
        """Mesh, size and camera."""
        camera = "orthographic" if self.camera.fov_deg is None else f"fov_deg={self.camera.fov_deg}"
        shadows = "" if self.shadows else ", no shadows"
        return f"MeshView({self.mesh.name!r}, {self._n}, {camera}, {len(self.pixels)} pixels{shadows})"

    def _identity(self) -> bytes:
        arrays = (self.mesh.vertices, self.mesh.normals, self.mesh.faces)
        settings = f"mesh {self._n} {self.camera} {self.shadows}".encode()  # the rest follows from these and the mesh
        return settings + b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)

    @cached_property
    def _offset(self) -> float:
        return _OFFSET * float(np.linalg.norm(self.mesh.vertices, axis=1).max())

    @cached_property
    def _tracer(self) -> RayTracer:
        return RayTracer(self.mesh)

    def _trace_pixels(self) -> tuple[Tensor, Hits]:
        """The mask (1, H, W), and what the rays of the pixels under it hit, point by point of every pixel.

        Facets are turned towards the camera, whatever the order of their corners.
        """
        steps = (torch.arange(self._fine, dtype=torch.float32) + 0.5) / self._fine
        v, u = torch.cartesian_prod(steps, steps).T
        masks, parts = [], []
        for pixels in torch.arange(self._n**2).split(max(1, _RAYS // self._fine**2)):
            origins, directions = self._camera_rays(pixels, u.expand(len(pixels), -1), v.expand(len(pixels), -1))
            away = directions.flatten(1)
            found = self._tracer.hits(origins.flatten(1), away)
            cosine = -(found.normals * away).sum(0)
            covered = (cosine > 0).view(len(pixels), -1).all(-1)
            masks.append(covered)
            inside = covered.repeat_interleave(self._fine**2)
            facets = torch.where((found.facet_normals * away).sum(0) > 0, -found.facet_normals, found.facet_normals)
            parts.append([vectors[:, inside] for vectors in (found.normals, found.positions, facets)])
        points = Hits(*(torch.cat(vectors, 1) for vectors in zip(*parts, strict=True)))
        return torch.cat(masks).view(1, self._n, self._n), points

    def surface(self, pixels: Tensor, u: Tensor, v: Tensor) -> SurfacePoints:
        """See View; answers for the nearest of the points that were traced in a pixel."""
        row, column = ((place * self._fine).to(torch.int64).clamp_(0, self._fine - 1) for place in (v, u))
        first = torch.searchsorted(self.pixels.to(pixels.device), pixels) * self._fine**2
        at = (first[:, None] + row * self._fine + column).cpu()

        def chosen(vectors: Tensor) -> Tensor:
            return vectors.index_select(1, at.ravel()).view(3, *at.shape).to(u.device)

        positions = chosen(self._points.positions)
        return SurfacePoints(
            chosen(self._points.normals), self._toward_camera(positions), positions, chosen(self._points.facet_normals)
        )

    def _toward_camera(self, positions: Tensor) -> Tensor:
        back = self.framing.back.to(positions).view(3, 1, 1)
        if self.camera.fov_deg is None:
            return back.expand_as(positions)
        camera = self.framing.target.to(positions).view(3, 1, 1) + self.framing.distance * back
        return normalize(camera - positions, dim=0)

    def _camera_rays(self, pixels: Tensor, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        """Origins and unit directions (3, Q, S) float32."""
        framing, step = self.framing, 2 * self.framing.half_width / self._n
        x = ((pixels % self._n)[:, None] + u) * step - framing.half_width
        y = framing.half_width - ((pixels // self._n)[:, None] + v) * step
        right, top, back, target = (
            vector.float().view(3, 1, 1) for vector in (framing.right, framing.top, framing.back, framing.target)
        )
        seen = target + x * right + y * top
        if self.camera.fov_deg is None:
            return seen + framing.distance * back, (-back).expand_as(seen)
        camera = (target + framing.distance * back).expand_as(seen)
        return camera, normalize(seen - camera, dim=0)

    def visibility(self, points: SurfacePoints, w_i: Tensor) -> Tensor | None:
        """See View; points whose facet faces away from the light are in the shadow of the shape itself."""
        if not self.shadows or points.positions is None or points.facet_normals is None:
            return None
        lit = ((points.normals * w_i).sum(0) > 0) & ((points.facet_normals * w_i).sum(0) > 0)
        chosen = lit.ravel().nonzero().ravel()
        vectors = (points.positions, points.facet_normals, w_i)
        positions, facets, toward_light = (v.reshape(3, -1).index_select(1, chosen).cpu() for v in vectors)
        start = positions.add_(facets, alpha=self._offset)
        free = ~self._tracer.blocked(start, toward_light).to(w_i.device)
        return lit.view(-1).index_copy(0, chosen, free).view(lit.shape)
