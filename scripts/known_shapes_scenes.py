"""What scripts/known_shapes.py measures on: shapes and their cameras, photographs, and the judgement of a fit."""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, pi, sin
from pathlib import Path

import numpy as np
import torch
import trimesh
from torch import Tensor

import torchbrdf as tb
from torchbrdf.estimator import DEFAULT_PENALTY, Penalty
from torchbrdf.mesh import TriangleMesh
from torchbrdf.metrics import relative_rms
from torchbrdf.rendering import render_tables
from torchbrdf.transport import DEFAULT_SAMPLES

PENALTIES: dict[str, Penalty] = {"default": DEFAULT_PENALTY, "paper": "paper"}

FRONT = tb.Camera()

SHAPES: dict[str, tuple[str, tb.Camera]] = {
    "sphere": ("", FRONT),
    "Buddha": ("buddha.ply", tb.Camera(toward=(0.25, 0.1, 1.0))),
    "bunny": ("bunny.ply", tb.Camera(toward=(-0.2, 0.2, 1.0))),
    "dragon": ("dragon.ply", tb.Camera(toward=(-0.1, 0.2, 1.0))),
    "teapot": ("teapot.obj", tb.Camera(toward=(0.0, 0.5, 1.0))),
}
"""File in the folder of shapes, and where the camera stands: its axes are those of the probe."""


def open_view(shape: str, folder: Path, size: int, shadows: bool = True) -> tb.View:
    """One of SHAPES."""
    name, camera = SHAPES[shape]
    return tb.MeshView(folder / name, size, camera, shadows) if name else tb.SphereView(size)


@dataclass(frozen=True)
class Judgement:
    """Errors of a fit: on its photograph, and mean of the novel probes, both relative RMS."""

    observation: float
    novel: float


class Judge:
    """Fits photographs of known materials, each with a library without it, and renders the result on a sphere.

    Under novel probes the BRDF is rendered as Y w, which differs from the table that a user saves only in cells
    below zero; `table_errors` renders the tables.
    """

    def __init__(
        self, library: tb.MaterialLibrary, materials: Sequence[str], probes: Mapping[str, tb.LightProbe], size: int
    ) -> None:
        """Render what the materials look like under the novel probes."""
        self.library, self.materials, self.probes = library, tuple(materials), probes
        self.view = tb.SphereView(size)
        self.tables = [library.table(material) for material in materials]
        self.classes = {material: tb.MaterialClasses.fit(library.without(material)) for material in materials}
        self.novel: dict[str, tuple[tb.BasisImages, Tensor]] = {}
        for name, probe in probes.items():
            truth = render_tables(self.tables, probe, self.view, 4 * DEFAULT_SAMPLES, seed=1)
            self.novel[name] = tb.render_basis(library, probe, self.view), truth

    def fit(
        self, basis: tb.BasisImages, images: Tensor, noise: float, penalty: Penalty = DEFAULT_PENALTY
    ) -> dict[str, tb.Reconstruction]:
        """By material: clean images (m, 3, H, W) with noise in per cent, each fitted without its own material."""
        found = {}
        for i, material in enumerate(self.materials):
            estimator = tb.BRDFEstimator(basis.without(material), self.classes[material], penalty)
            found[material] = estimator(noisy(images[i], noise, i))
        return found

    def judge(self, results: Mapping[str, tb.Reconstruction]) -> dict[str, Judgement]:
        """How good the fits of `fit` are."""
        judgements = {}
        for i, (material, result) in enumerate(results.items()):
            errors = []
            for basis, truth in self.novel.values():
                packed = torch.einsum("nc,ncp->cp", result.weights, basis.without(material).packed)
                errors.append(relative_rms(basis.unpack(packed), truth[i], self.view.mask))
            judgements[material] = Judgement(float(result.relative_error), float(np.mean(errors)))
        return judgements

    def table_errors(self, tables: Sequence[tb.MerlTable], materials: Sequence[str]) -> Tensor:
        """(len(tables),): errors under the novel probes, mean, of whole tables instead of Y w."""
        errors = torch.zeros(len(tables))
        for name, probe in self.probes.items():
            images = render_tables(tables, probe, self.view, seed=2)
            for i, (image, material) in enumerate(zip(images, materials, strict=True)):
                truth = self.novel[name][1][self.materials.index(material)]
                errors[i] += relative_rms(image, truth, self.view.mask) / len(self.probes)
        return errors


def noisy(image: Tensor, percent: float, seed: int) -> Tensor:
    """A photograph: each pixel times 1 + a normal number of this standard deviation."""
    noise = torch.randn(image.shape, generator=torch.Generator().manual_seed(seed))
    return image * (1 + percent / 100 * noise)


@dataclass(frozen=True)
class Photographs:
    """Clean images of materials, as two halves of independent samples.

    halves  (2, m, 3, H, W)
    """

    halves: Tensor

    @property
    def images(self) -> Tensor:
        """(m, 3, H, W)."""
        return self.halves.mean(0)

    @property
    def noise(self) -> Tensor:
        """(m,): relative RMS of the Monte Carlo error."""
        difference = torch.linalg.vector_norm((self.halves[0] - self.halves[1]).flatten(1), dim=1)
        return difference / 2 / torch.linalg.vector_norm(self.images.flatten(1), dim=1)


def photograph(
    tables: Sequence[tb.MerlTable], probe: tb.LightProbe, view: tb.View, samples: int = 2 * DEFAULT_SAMPLES
) -> Photographs:
    """A view of materials in light that is reflected once; two halves of `samples` each, with seeds of their own."""
    halves = [render_tables(tables, probe, view, samples, seed=1000 + half) for half in range(2)]
    return Photographs(torch.stack(halves))


# Shapes with few normals


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


def few_normals() -> dict[str, tuple[TriangleMesh, tb.Camera]]:
    """Shapes from a plane to a sphere, and how they are seen."""
    plane = faceted(trimesh.creation.box((2.0, 2.0, 1e-3)), "plane")
    cube = faceted(trimesh.creation.box((2.0, 2.0, 2.0)), "cube")
    corner = (1.0, 0.8, 1.2)
    tilted = (sin(0.7), 0.0, cos(0.7))
    shapes = {
        "plane": (plane, FRONT),
        "plane, tilted 40 degrees": (plane, tb.Camera(toward=tilted)),
        "plane, perspective 60 degrees": (plane, tb.Camera(fov_deg=60, width=2.0)),
        "cube": (cube, tb.Camera(toward=corner)),
        "cube, perspective 60 degrees": (cube, tb.Camera(toward=corner, fov_deg=60)),
        "cylinder": (cylinder(), FRONT),
        "cylinder, perspective 60 degrees": (cylinder(), tb.Camera(toward=(0.0, 0.6, 1.0), fov_deg=60)),
        "icosahedron": (faceted(trimesh.creation.icosahedron(), "icosahedron"), tb.Camera(toward=corner)),
        "ball of 80 faces": (faceted(trimesh.creation.icosphere(1), "ball"), tb.Camera(toward=corner)),
        "ball of 320 faces": (faceted(trimesh.creation.icosphere(2), "ball"), tb.Camera(toward=corner)),
        "half sphere from the side": (half_sphere_from_the_side(), FRONT),
    }
    for opening in (10, 20, 30, 40, 60, 75):
        shapes[f"cap of {opening} degrees"] = (cap(opening), tb.Camera(width=2 * sin(np.radians(opening))))
    shapes["sphere"] = (cap(180), FRONT)
    return shapes


def mesh_view(mesh: TriangleMesh, camera: tb.Camera, size: int) -> tb.MeshView:
    """A view of a mesh that no file holds; these shapes are convex, so no shadows."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shape.ply"
        mesh.save(path)
        return tb.MeshView(path, size, camera, shadows=False)
