"""What known_shapes.py measures on: shapes and their cameras, photographs, and the judgement of a fit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf.estimation import DEFAULT_PENALTY, Penalty
from torchbrdf.experiments import FRONT
from torchbrdf.images import relative_rms
from torchbrdf.rendering import render_tables
from torchbrdf.transport import DEFAULT_SAMPLES

PENALTIES: dict[str, Penalty] = {"default": DEFAULT_PENALTY, "paper": "paper"}


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
                shown = basis.without(material).render(result.weights)
                errors.append(relative_rms(shown, truth[i], self.view.mask))
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


