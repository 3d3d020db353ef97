"""`TriangleMesh`: the geometry of a known shape, read from a file and made sound."""

import os
import re
import warnings
from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from torchbrdf.files import existing_file, writing

if TYPE_CHECKING:
    import trimesh

MESH_SUFFIXES = (".ply", ".obj")
CREASE_ANGLE = radians(60)
"""Faces that meet at a larger angle keep normals of their own, where a file brings none."""

_MAX_HEADER = 1 << 16
_FARTHEST = 1e30
_ZEROTH_VERTEX = re.compile(rb"(?m)^[ \t]*f[ \t](?:.*[ \t])?0(?:/|\s|$)")

_UNREADABLE = (
    ValueError, LookupError, TypeError, AttributeError, NameError, NotImplementedError, MemoryError, DeprecationWarning
)  # fmt: skip
"""What trimesh raises for damaged files; the warning is what NumPy before 2.3 says of text that is no number."""


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
        """Read a .ply or .obj file.

        Faces of more than three corners are cut into triangles; triangles without area are left out with a
        warning. Where the file has no normals they are computed, with a warning: means over the faces around a
        vertex, but not across edges sharper than CREASE_ANGLE.
        Raises FileNotFoundError, or ValueError where the file is no mesh, has no faces, or is damaged.
        """
        path = Path(path)
        parts = _read(path)
        n_given = sum(len(part.faces) for part in parts)
        sound = [_without_degenerate(part) for part in parts if len(part.faces)]
        n_faces = sum(len(part.faces) for part in sound)
        if n_faces == 0:
            reason = f"all of its {n_given} triangles have no area" if n_given else "it has no faces"
            raise ValueError(f"{path}: {reason}; a shape needs a mesh of triangles, not a point cloud")
        if n_faces < n_given:
            _warn(f"{path}: left out {n_given - n_faces} of {n_given} triangles, which have no area")
        smooth = [_with_normals(part) for part in sound if len(part.faces)]
        if any(computed for _, computed in smooth):
            _warn(f"{path}: has no vertex normals; smooth ones were computed from its faces")
        offsets = np.cumsum([0] + [len(part.vertices) for part, _ in smooth[:-1]])
        return cls(
            vertices=np.concatenate([part.vertices for part, _ in smooth]).astype(np.float32),
            normals=np.concatenate([part.vertex_normals for part, _ in smooth]).astype(np.float32),
            faces=np.concatenate([part.faces + offset for (part, _), offset in zip(smooth, offsets, strict=True)]),
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


def _read(path: Path) -> list["trimesh.Trimesh"]:
    existing_file(path, f"a mesh, {' or '.join(MESH_SUFFIXES)}")
    if path.suffix.lower() not in MESH_SUFFIXES:
        known = " or ".join(MESH_SUFFIXES)
        raise ValueError(f"{path}: a mesh must be a {known} file, got {path.suffix or 'no suffix'!r}")
    import trimesh

    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", "string or file could not be read to its end", DeprecationWarning)
            scene = trimesh.load_scene(path, process=False)
    except _UNREADABLE as error:
        raise ValueError(f"{path}: not a sound {path.suffix} mesh: {' '.join(str(error).split())}") from None
    parts = [part for part in scene.geometry.values() if isinstance(part, trimesh.Trimesh)]
    promised = _promised_faces(path)
    found = sum(len(part.faces) for part in parts)
    if found < promised:
        raise ValueError(f"{path}: the header promises {promised} faces and the file has {found}; is it truncated?")
    if path.suffix.lower() == ".obj" and _ZEROTH_VERTEX.search(path.read_bytes()):
        raise ValueError(f"{path}: a face names the vertex with index 0, but .obj files count from 1")
    for part in parts:
        _check_part(part, path)
    return parts


def _check_part(part: "trimesh.Trimesh", path: Path) -> None:
    if part.vertices.ndim != 2 or part.vertices.shape[1] != 3:
        raise ValueError(f"{path}: vertices must have three coordinates, got {part.vertices.shape}")
    if not (np.abs(part.vertices) < _FARTHEST).all():
        raise ValueError(f"{path}: some vertices are NaN, infinite or beyond {_FARTHEST:g}")
    if len(part.faces) and not (part.faces.min() >= 0 and part.faces.max() < len(part.vertices)):
        wrong = part.faces.min() if part.faces.min() < 0 else part.faces.max()
        raise ValueError(f"{path}: a face names the vertex with index {wrong}, of {len(part.vertices)}")


def _promised_faces(path: Path) -> int:
    """What the header of a .ply file says; 0 for other files."""
    if path.suffix.lower() != ".ply":
        return 0
    with open(path, "rb") as file:
        header = file.read(_MAX_HEADER).partition(b"end_header")[0]
    found = re.search(rb"element\s+face\s+(\d+)", header)
    return int(found[1]) if found else 0


def _without_degenerate(part: "trimesh.Trimesh") -> "trimesh.Trimesh":
    """Less the triangles whose area is within rounding of 0; where all are sound the mesh itself."""
    import trimesh

    corners = part.vertices[part.faces]
    edges = corners - np.roll(corners, 1, axis=1)
    doubled = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    sound = doubled > 1e-10 * (edges**2).sum(-1).max(1, initial=0)
    if sound.all():
        return part
    normals = part.vertex_normals if _brings_normals(part) else None
    return trimesh.Trimesh(part.vertices, part.faces[sound], vertex_normals=normals, process=False)


def _brings_normals(part: "trimesh.Trimesh") -> bool:
    """Whether the file had normals: trimesh keeps them where it keeps what it computes, and computed none yet."""
    return "vertex_normals" in part._cache


def _with_normals(part: "trimesh.Trimesh") -> tuple["trimesh.Trimesh", bool]:
    """The mesh with unit vertex normals, and whether they had to be computed."""
    import trimesh

    if _brings_normals(part):
        lengths = np.linalg.norm(part.vertex_normals[np.unique(part.faces)], axis=1)
        if np.allclose(lengths, 1, atol=0.01):
            return part, False
    smooth = trimesh.graph.smooth_shade(part, angle=CREASE_ANGLE)
    if (np.linalg.norm(smooth.vertex_normals[np.unique(smooth.faces)], axis=1) > 0.99).all():
        return smooth, True
    # The normals of sheets with two sides cancel at their vertices: every face gets its own.
    corners = part.vertices[part.faces].reshape(-1, 3)
    normals = np.repeat(part.face_normals, 3, axis=0)
    faces = np.arange(len(corners)).reshape(-1, 3)
    return trimesh.Trimesh(corners, faces, vertex_normals=normals, process=False), True


def _warn(message: str) -> None:
    warnings.warn(message, UserWarning, stacklevel=4)
