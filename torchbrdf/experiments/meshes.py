"""Shapes that show few normals to many, as meshes."""

import tempfile
from math import cos, pi, sin
from pathlib import Path

import numpy as np
import trimesh

from torchbrdf.view import Camera, MeshView, TriangleMesh

FRONT = Camera()


def cap(opening_deg: float, steps: int = 64) -> TriangleMesh:
    """The part of a unit sphere within an angle of +Z; 90 is a hemisphere, 180 a sphere."""
    theta = np.radians(opening_deg) * np.arange(steps + 1) / steps
    phi = 2 * pi * np.arange(2 * steps) / (2 * steps)
    ring = np.stack([np.outer(np.sin(theta), np.cos(phi)), np.outer(np.sin(theta), np.sin(phi))], -1)
    z = np.broadcast_to(np.cos(theta)[:, None, None], (*ring.shape[:2], 1))
    vertices = np.concatenate([ring, z], -1).reshape(-1, 3)
    i, j = (index.ravel() for index in np.meshgrid(np.arange(steps), np.arange(2 * steps), indexing="ij"))
    a, b = i * 2 * steps + j, i * 2 * steps + (j + 1) % (2 * steps)
    c, d = a + 2 * steps, b + 2 * steps
    whole = -2 * steps if opening_deg == 180 else None
    faces = np.concatenate([np.stack([a, c, d], 1)[:whole], np.stack([a, d, b], 1)[2 * steps :]])
    return _mesh(vertices, vertices, faces, f"cap {opening_deg:g}")


def half_sphere_from_the_side() -> TriangleMesh:
    """The half x >= 0 of a unit sphere, closed by a disc that the camera sees edge-on."""
    whole = cap(180)
    keep = (whole.vertices[whole.faces][..., 0] > -1e-6).all(1)
    return TriangleMesh(whole.vertices, whole.normals, whole.faces[keep], "half sphere")


def faceted(mesh: trimesh.Trimesh, name: str) -> TriangleMesh:
    """A mesh whose faces are flat."""
    normals = np.repeat(mesh.face_normals, 3, axis=0)
    return _mesh(mesh.triangles.reshape(-1, 3), normals, np.arange(3 * len(mesh.faces)).reshape(-1, 3), name)


def cylinder(sections: int = 256) -> TriangleMesh:
    """An upright cylinder, smooth, with flat ends."""
    upright = trimesh.creation.cylinder(radius=1.0, height=2.0, sections=sections)
    upright.apply_transform(trimesh.transformations.rotation_matrix(-pi / 2, [1, 0, 0]))
    flat = faceted(upright, "cylinder")
    around = flat.vertices * [1, 0, 1]
    side = np.abs(flat.normals[:, 1:2]) < 0.5
    normals = np.where(side, around / np.maximum(np.linalg.norm(around, axis=1, keepdims=True), 1e-9), flat.normals)
    return _mesh(flat.vertices, normals, flat.faces, "cylinder")


def _mesh(vertices: np.ndarray, normals: np.ndarray, faces: np.ndarray, name: str) -> TriangleMesh:
    return TriangleMesh(vertices.astype(np.float32), normals.astype(np.float32), faces, name)


def few_normals() -> dict[str, tuple[TriangleMesh, Camera]]:
    """Shapes from a plane to a sphere, and how they are seen."""
    plane = faceted(trimesh.creation.box((2.0, 2.0, 1e-3)), "plane")
    cube = faceted(trimesh.creation.box((2.0, 2.0, 2.0)), "cube")
    corner = (1.0, 0.8, 1.2)
    tilted = (sin(0.7), 0.0, cos(0.7))
    shapes = {
        "plane": (plane, FRONT),
        "plane, tilted 40 degrees": (plane, Camera(toward=tilted)),
        "plane, perspective 60 degrees": (plane, Camera(fov_deg=60, width=2.0)),
        "cube": (cube, Camera(toward=corner)),
        "cube, perspective 60 degrees": (cube, Camera(toward=corner, fov_deg=60)),
        "cylinder": (cylinder(), FRONT),
        "cylinder, perspective 60 degrees": (cylinder(), Camera(toward=(0.0, 0.6, 1.0), fov_deg=60)),
        "icosahedron": (faceted(trimesh.creation.icosahedron(), "icosahedron"), Camera(toward=corner)),
        "ball of 80 faces": (faceted(trimesh.creation.icosphere(1), "ball"), Camera(toward=corner)),
        "ball of 320 faces": (faceted(trimesh.creation.icosphere(2), "ball"), Camera(toward=corner)),
        "half sphere from the side": (half_sphere_from_the_side(), FRONT),
    }
    for opening in (10, 20, 30, 40, 60, 75):
        shapes[f"cap of {opening} degrees"] = (cap(opening), Camera(width=2 * sin(np.radians(opening))))
    shapes["sphere"] = (cap(180), FRONT)
    return shapes


def mesh_view(mesh: TriangleMesh, camera: Camera, size: int) -> MeshView:
    """A view of a mesh that no file holds; these shapes are convex, so no shadows."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shape.ply"
        mesh.save(path)
        return MeshView(path, size, camera, shadows=False)
