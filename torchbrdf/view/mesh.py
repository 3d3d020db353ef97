"""`TriangleMesh`: the geometry of a known shape, read from a file and made sound."""

import os
from dataclasses import dataclass
from math import radians
from pathlib import Path

import numpy as np

from torchbrdf.arguments import warn
from torchbrdf.files import existing_file, printable, writing
from torchbrdf.view._gltf import read_gltf
from torchbrdf.view._obj import read_obj
from torchbrdf.view._ply import read_ply
from torchbrdf.view._polygons import Polygons

MESH_SUFFIXES = (".ply", ".obj", ".glb", ".gltf")
CREASE_ANGLE = radians(60)
"""Faces that meet at a larger angle keep normals of their own, where a file brings none."""

_FARTHEST, _NEAREST = 1e30, 1e-37  # of single precision
_KNOWN = f"{', '.join(MESH_SUFFIXES[:-1])} or {MESH_SUFFIXES[-1]}"
_LOST = "have no area, fewer than three corners, or cross themselves"
_LOST_ONE = "has no area, fewer than three corners, or crosses itself"

Triangles = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Vertices, normals and faces, as in `TriangleMesh`."""


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Triangles with smooth normals, in the file's own units and axes.

    vertices  (V, 3)  float32
    normals   (V, 3)  float32, unit vectors
    faces     (F, 3)  int64, no triangle without area
    name      what messages call it
    """

    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    name: str = "mesh"

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> "TriangleMesh":
        """Read a .ply, .obj, .glb or .gltf file.

        Faces of more than three corners are cut into triangles, concave ones too; faces that cross themselves and
        triangles without area are left out with a warning, vertices of no face without one. Where the file has no
        normals they are computed, with a warning: means over the faces around a vertex, but not across edges sharper
        than CREASE_ANGLE.
        Raises FileNotFoundError, or ValueError where the file is no mesh, has no faces, or is damaged.
        """
        path = Path(path)
        parts, n_given, n_lost, n_faces = [], 0, 0, 0
        for polygons in _read(path):
            faces, lost = polygons.triangles()
            sound = _with_area(polygons.vertices, faces)
            n_given, n_lost, n_faces = n_given + len(faces), n_lost + lost, n_faces + len(sound)
            if len(sound):
                parts.append(_with_normals(polygons.vertices, sound, polygons.normals))
        if n_faces == 0:
            reason = f"all of its {n_given} triangles have no area" if n_given else "it has no faces"
            if n_lost and not n_given:
                reason = f"all of its {n_lost} faces {_LOST}" if n_lost > 1 else f"the only face {_LOST_ONE}"
            raise ValueError(f"{path}: {reason}; a shape needs a mesh of triangles, not a point cloud")
        if n_lost:
            warn(f"{path}: left out " + (f"{n_lost} faces that {_LOST}" if n_lost > 1 else f"1 face that {_LOST_ONE}"))
        if n_faces < n_given:
            warn(f"{path}: left out {n_given - n_faces} of {n_given} triangles, which have no area")
        for reason in sorted({reason for _, reason in parts if reason}):
            warn(f"{path}: {reason}; smooth ones were computed from its faces")
        vertices, normals, triangles = zip(*(arrays for arrays, _ in parts), strict=True)
        offsets = np.cumsum([0] + [len(part) for part in vertices[:-1]])
        return cls(
            vertices=np.concatenate(vertices).astype(np.float32),
            normals=np.concatenate(normals).astype(np.float32),
            faces=np.concatenate([part + offset for part, offset in zip(triangles, offsets, strict=True)]),
            name=path.stem,
        )

    def __repr__(self) -> str:
        """Name and size."""
        return f"TriangleMesh({self.name!r}, {len(self.vertices)} vertices, {len(self.faces)} triangles)"

    @property
    def centre(self) -> np.ndarray:
        """(3,) float64: the middle of the bounding box."""
        return (self.vertices.min(0).astype(float) + self.vertices.max(0)) / 2

    @property
    def radius(self) -> float:
        """Of the smallest sphere about `centre` that holds all vertices."""
        return float(np.linalg.norm(self.vertices - self.centre, axis=1).max())

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a binary .ply file with normals."""
        import trimesh

        mesh = trimesh.Trimesh(self.vertices, self.faces, vertex_normals=self.normals, process=False)
        with writing(path) as temporary:
            temporary.write_bytes(trimesh.exchange.ply.export_ply(mesh, vertex_normal=True))


def _read(path: Path) -> list[Polygons]:
    existing_file(path, f"a mesh, {_KNOWN}")
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise ValueError(f"{path}: a mesh must be a {_KNOWN} file, got {path.suffix or 'no suffix'!r}")
    content = path.read_bytes()
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # what comes of it is refused below
            match path.suffix.lower():
                case ".obj":
                    parts = read_obj(content)
                case ".ply":
                    parts = read_ply(content)
                case _:
                    parts = read_gltf(content, path.parent)
        parts = [part.compact() for part in parts]
    except ValueError as error:
        raise ValueError(f"{path}: not a sound {path.suffix} mesh: {printable(str(error))}") from None
    for part in parts:
        if not (np.abs(part.vertices) < _FARTHEST).all():
            raise ValueError(f"{path}: some vertices are NaN, infinite or beyond {_FARTHEST:g}")
        if 0 < np.abs(part.vertices).max(initial=0) < _NEAREST:
            raise ValueError(f"{path}: all vertices are within {_NEAREST:g} of one point; is it the right unit?")
    return parts


def _with_area(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The triangles whose area is not 0 within rounding."""
    return faces[np.linalg.norm(_areas(vertices[faces]), axis=1) > 1e-10]


def _areas(corners: np.ndarray) -> np.ndarray:
    """(T, 3) along the normals of triangles (T, 3, 3), as long as twice their area over their longest edge's square."""
    edges = corners - np.roll(corners, 1, axis=1)
    longest = np.abs(edges).max((1, 2), initial=0)[:, None, None]  # first, as squares of tiny ones are 0
    edges = edges / np.where(longest > 0, longest, 1)
    areas: np.ndarray = np.cross(edges[:, 0], edges[:, 1])
    return areas / np.maximum((edges**2).sum(-1).max(1, initial=0), 1)[:, None]


def _with_normals(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray | None) -> tuple[Triangles, str]:
    """Vertices, unit vertex normals and faces; and why the normals had to be computed, "" where they are the file's."""
    import trimesh

    reason = "has no vertex normals"
    if normals is not None:
        lengths = np.linalg.norm(normals[np.unique(faces)], axis=1)
        if np.allclose(lengths, 1, atol=0.01):
            return (vertices, normals, faces), ""
        reason = "has vertex normals that are not of unit length"
    scale = np.exp2(-np.floor(np.log2(np.abs(vertices[faces]).max())))  # trimesh takes areas below 1e-14 for none
    part = trimesh.Trimesh(vertices * scale, faces, process=False)
    smooth = trimesh.graph.smooth_shade(part, angle=CREASE_ANGLE)
    placed, triangles, means = smooth.vertices / scale, smooth.faces.copy(), smooth.vertex_normals
    # The normals of sheets with two sides cancel at their vertices: faces get their own there.
    lost = (np.linalg.norm(means[triangles], axis=2) < 0.99).any(1)
    corners = placed[triangles[lost]]
    own = _areas(corners)
    own /= np.linalg.norm(own, axis=1, keepdims=True)
    triangles[lost] = len(placed) + np.arange(3 * len(corners)).reshape(-1, 3)
    vertices, normals = np.concatenate([placed, corners.reshape(-1, 3)]), np.concatenate([means, own.repeat(3, axis=0)])
    return (vertices, normals, triangles), reason
