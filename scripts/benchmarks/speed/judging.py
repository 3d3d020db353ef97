"""The errors beside the times."""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import degrees
from pathlib import Path

import torch
from torch import Tensor

import torchbrdf as tb
from harmonic import summary
from speed.inputs import TURNS, Inputs
from speed.references import References
from speed.settings import SIZE, TABLES
from torchbrdf.images import relative_rms
from torchbrdf.light import rotation_angle

_SAMPLES = 4096
"""Of the pictures by which tables are judged."""

_EVERY = 101
"""Cells of a table from one that is judged to the next."""


@dataclass(frozen=True)
class Error:
    """One number that is to be small, and how a table says it."""

    value: float
    words: str


@dataclass(frozen=True)
class Judge:
    """What errors are measured with."""

    inputs: Inputs
    references: References

    @classmethod
    def of(cls, folder: Path) -> "Judge":
        """With inputs and references in a folder."""
        return cls(Inputs.of(folder), References(folder / "references"))

    @cached_property
    def _novel(self) -> tuple[tb.LightProbe, tb.SphereView, Tensor]:
        return self.inputs.novel_probe, tb.SphereView(SIZE), self.inputs.tensor("novel")

    def tables(self, results: Sequence[Path]) -> Error:
        """Of the first photographs' tables, under the novel light; mean."""
        probe, view, _ = self._novel
        shown = [tb.render(tb.MerlTable.open(folder / "brdf.binary"), probe, view, _SAMPLES) for folder in results]
        return self.shown(shown)

    def shown(self, images: Sequence[Tensor] | Tensor) -> Error:
        """Of pictures of the first photographs' materials (B, 3, H, W), under the novel light; mean."""
        _, view, truth = self._novel
        mean = statistics.mean(relative_rms(image, truth[i], view.mask) for i, image in enumerate(images))
        return Error(mean, f"{mean:.2%}")

    def basis(self, packed: Tensor, light: str, library: tb.MaterialLibrary) -> tuple[Error, str]:
        """That within which 95 % of the basis images are; median and worst, too; and those of the reference."""
        reference = self.references.basis(library, self._probe(light), tb.SphereView(SIZE))
        errors = reference.errors(packed)
        found, own = (summary(some).replace(" | ", ", ") for some in (errors, reference.own))
        return Error(float(errors.quantile(0.95)), found), own

    def combined(self, path: Path, weights: Tensor, library: tb.MaterialLibrary) -> str:
        """Of a table of weights (n, 3): the relative RMS difference to their sum in float64, in some of the cells."""
        table = tb.MerlTable.open(path)
        cells = torch.nonzero(table.valid.ravel()).ravel()[::_EVERY]
        exact = (library.rows(cells).double() @ weights.double()).clamp_min(0)
        found = table.values.reshape(-1, 3)[cells].double().clamp_min(0)
        return f"{float((found - exact).norm() / exact.norm()):.1e}"

    def picture(self, image: Tensor, table: str, light: str) -> Error:
        """Of a rendering, and of its reference."""
        reference = self.references.tables(self.inputs.tables, self._probe(light), image.shape[-1])
        k = list(TABLES).index(table)
        error = float(reference.errors(reference.view.pack(image)[None].expand_as(reference.images))[k])
        return Error(error, f"{error:.2%} ± {float(reference.own[k]):.2%}")

    def _probe(self, light: str) -> tb.LightProbe:
        return tb.LightProbe.open(self.inputs.probes[light])


def left(rotation: Tensor, search: str) -> Error:
    """Degrees between a rotation that `align` found and the true one."""
    angle = degrees(rotation_angle(rotation.double() @ TURNS[search].T))
    return Error(angle, f"{angle:.2f} degrees")


def accurate(error: Error | None, limit: float | None) -> tuple[float, bool] | None:
    """The limit and whether an error is within it, for a row."""
    return None if limit is None or error is None else (limit, error.value <= limit)
