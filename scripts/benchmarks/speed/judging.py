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
from torchbrdf.light import rotation_vector

_SAMPLES = 4096
"""Of the pictures by which tables are judged."""


@dataclass(frozen=True)
class Judge:
    """What errors are measured with; all are given in words."""

    inputs: Inputs
    references: References

    @classmethod
    def of(cls, folder: Path) -> "Judge":
        """With inputs and references in a folder."""
        return cls(Inputs.of(folder), References(folder / "references"))

    @cached_property
    def _novel(self) -> tuple[tb.LightProbe, tb.SphereView, Tensor]:
        return self.inputs.novel_probe, tb.SphereView(SIZE), self.inputs.tensor("novel")

    def tables(self, results: Sequence[Path]) -> str:
        """Of the first photographs' tables, under the novel light; mean."""
        probe, view, _ = self._novel
        shown = [tb.render(tb.MerlTable.open(folder / "brdf.binary"), probe, view, _SAMPLES) for folder in results]
        return self._shown(shown)

    def weights(self, weights: Tensor, library: tb.MaterialLibrary) -> str:
        """Of the first photographs' weights, (B, n, 3) or (n, 3), under the novel light; mean."""
        probe, view, _ = self._novel
        basis = self.references.basis(library, probe, view).images
        weights = weights if weights.dim() == 3 else weights[None]
        return self._shown(view.unpack(torch.einsum("nsp,bns->bsp", basis, weights.float()).clamp_min(0)))

    def _shown(self, images: Sequence[Tensor] | Tensor) -> str:
        _, view, truth = self._novel
        return f"{statistics.mean(relative_rms(image, truth[i], view.mask) for i, image in enumerate(images)):.2%}"

    def basis(self, packed: Tensor, light: str, library: tb.MaterialLibrary) -> tuple[str, str]:
        """Median, 95 % and worst of all basis images; and of the reference."""
        reference = self.references.basis(library, self._probe(light), tb.SphereView(SIZE))
        found, own = (summary(errors).replace(" | ", ", ") for errors in (reference.errors(packed), reference.own))
        return found, own

    def picture(self, image: Tensor, table: str, light: str) -> str:
        """Of a rendering, and of its reference."""
        reference = self.references.tables(self.inputs.tables, self._probe(light), image.shape[-1])
        k = list(TABLES).index(table)
        error = reference.errors(reference.view.pack(image)[None].expand_as(reference.images))[k]
        return f"{float(error):.2%} ± {float(reference.own[k]):.2%}"

    def _probe(self, light: str) -> tb.LightProbe:
        return tb.LightProbe.open(self.inputs.probes[light])


def left(rotation: Tensor, search: str) -> str:
    """Degrees between a rotation that `align` found and the true one."""
    return f"{degrees(float(rotation_vector(rotation.double() @ TURNS[search].T).norm())):.2f} degrees"
