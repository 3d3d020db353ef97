"""`Polygons`: faces of any number of corners, and the triangles that they are cut into."""

from dataclasses import dataclass
from typing import Self

import numpy as np

_SLIVER = 1e-10
"""Areas below this, relative to the square of the size, are 0 within rounding."""

_CROSSING = 1e-6
"""Triangles of a polygon that does not cross itself have its area, within this part of it."""


@dataclass(frozen=True, eq=False)
class Polygons:
    """Faces as files hold them.

    vertices  (V, 3)  float64
    counts    (F,)    int64, the corners of each face
    corners   (C,)    int64, the vertices of the faces, face by face
    normals   (V, 3)  float64, at the vertices; None where the file has none
    """

    vertices: np.ndarray
    counts: np.ndarray
    corners: np.ndarray
    normals: np.ndarray | None = None

    def compact(self) -> Self:
        """Without the vertices that belong to no face; raises ValueError where a vertex is missing or no number."""
        n_vertices = len(self.vertices)
        low, high = self.corners.min(initial=0), self.corners.max(initial=-1)
        if low < 0 or high >= n_vertices:
            raise ValueError(f"a face names the vertex with index {low if low < 0 else high}, of {n_vertices}")
        used = np.zeros(n_vertices, dtype=bool)
        used[self.corners] = True
        if used.all():
            return self
        normals = None if self.normals is None else self.normals[used]
        return type(self)(self.vertices[used], self.counts, (np.cumsum(used) - 1)[self.corners], normals)

    def triangles(self) -> tuple[np.ndarray, int]:
        """Triangles (T, 3) int64 that cover the faces, and the number of faces that cannot be covered.

        A face is cut in the plane of its mean normal [Newell], from its first vertex in the file: at which corner
        the face begins makes no difference. Left out are faces of fewer than three different corners, without
        area, and those that cross themselves.
        """
        starts = np.cumsum(self.counts) - self.counts
        parts, n_lost = [np.empty((0, 3), np.int64)], 0
        for n in np.unique(self.counts).tolist():
            faces = self.corners[starts[self.counts == n, None] + np.arange(n)]
            if n < 3:
                n_lost += len(faces)
            elif n == 3:
                parts.append(faces)
            else:
                covered, lost = self._cut(faces)
                parts.append(covered)
                n_lost += lost
        return np.concatenate(parts), n_lost

    def _cut(self, faces: np.ndarray) -> tuple[np.ndarray, int]:
        """Faces (F, n) of n > 3 corners."""
        n = faces.shape[1]
        faces = np.take_along_axis(faces, (faces.argmin(1)[:, None] + np.arange(n)) % n, axis=1)
        points = self.vertices[faces] - self.vertices[faces[:, :1]]
        area = np.cross(points[:, 1:-1], points[:, 2:]).sum(1)
        size = (points**2).sum(-1).max(1)
        doubled = np.linalg.norm(area, axis=1)
        normal = area / np.where(doubled > 0, doubled, 1)[:, None]

        def sound(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
            """Whether triangles of corners (F, k, 3) turn the way in which their face does."""
            turns = np.einsum("fki,fi->fk", np.cross(b - a, c - a), normal)
            return (turns > _SLIVER * size[:, None]).all(1)

        first = points[:, :1]
        # All corners lie within half a turn about the first, in order: a fan covers the face.
        fan = sound(first, points[:, 1:-1], points[:, 2:]) & sound(first, points[:, 1:2], points[:, 2:])
        split = np.zeros_like(fan)
        if n == 4:
            split = sound(points[:, 1:2], points[:, [2, 3]], points[:, [3, 0]])
            shorter = ((points[:, 1] - points[:, 3]) ** 2).sum(-1) < (points[:, 2] ** 2).sum(-1)
            fan, split = fan & ~(split & shorter), split & ~(fan & ~shorter)
        fans = faces[fan]
        parts = [np.stack([np.broadcast_to(fans[:, :1], fans[:, 2:].shape), fans[:, 1:-1], fans[:, 2:]], -1)]
        parts.append(faces[split][:, [[1, 2, 3], [1, 3, 0]]])
        hard = [_ears(face, self.vertices[face]) for face in faces[~(fan | split)]]
        parts += [ears for ears in hard if ears is not None]
        return np.concatenate([part.reshape(-1, 3) for part in parts]), sum(ears is None for ears in hard)


def _ears(face: np.ndarray, points: np.ndarray) -> np.ndarray | None:
    """Triangles of a face (n,) that need not be convex, its corners at (n, 3); None where it crosses itself."""
    from mapbox_earcut import triangulate_float64

    apart = (points != np.roll(points, 1, axis=0)).any(1)
    face, points = face[apart], points[apart]
    if len(face) < 3:
        return None
    points = points - points[0]
    area = np.cross(points[1:-1], points[2:]).sum(0)
    axis = int(np.abs(area).argmax())
    doubled = area[axis]
    smallest = _SLIVER * (points**2).sum(1).max()
    if abs(doubled) <= smallest:
        return None
    flat = np.ascontiguousarray(points[:, [(axis + 1) % 3, (axis + 2) % 3]])
    ears = triangulate_float64(flat, np.array([len(flat)], np.uint32)).reshape(-1, 3).astype(np.int64)
    a, b, c = flat[ears].swapaxes(0, 1)
    turns = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    if abs(np.abs(turns).sum() - abs(doubled)) > _CROSSING * abs(doubled):
        return None
    reversed_ = (turns > 0) != (doubled > 0)
    ears[reversed_] = ears[reversed_][:, ::-1]
    return face[ears[np.abs(turns) > smallest]]
