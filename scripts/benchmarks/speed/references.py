"""Converged images that errors are measured against, kept in a folder; none is made by what is measured.

All are means of two runs of the sampled transport with many times the default's samples and seeds that nothing else
uses. How far one of them is from the mean tells the reference's own error.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

import torchbrdf as tb
from harmonic import errors_of, reference_of
from speed.inputs import images_of
from torchbrdf.files import writing

SAMPLES = 32768
_SEEDS = (9100, 9101)
_EVERY = 4
"""Of how many rows, and columns, of a large picture one is compared: the rest would take minutes and tell the same."""


class SomePixels(tb.SphereView):
    """A sphere of which only one pixel in a few, along each side, is looked at."""

    def __init__(self, size: int, every: int) -> None:
        """Leave the others out of the mask."""
        super().__init__(size)
        kept = torch.zeros_like(self.mask)
        kept[:, every // 2 :: every, every // 2 :: every] = True
        self.mask = self.mask & kept


@dataclass(frozen=True)
class Reference:
    """images (n, 3, P) over the pixels of a view, and how far one of the two runs is from their mean, (n,)."""

    images: Tensor
    own: Tensor

    def errors(self, found: Tensor) -> Tensor:
        """(n,) relative RMS errors of images of the same shape."""
        return errors_of(found, self.images)


@dataclass(frozen=True)
class References:
    """The folder."""

    folder: Path

    def basis(self, library: tb.MaterialLibrary, probe: tb.LightProbe, view: tb.View) -> Reference:
        """All basis images."""
        name = f"basis-{library.source[:8]}-{len(library)}-{probe.fingerprint[:8]}-{view.fingerprint[:8]}"
        return self._kept(name, lambda: reference_of(library, probe, view, SAMPLES))

    def tables(self, files: Mapping[str, Path], probe: tb.LightProbe, size: int) -> tuple[Reference, tb.View]:
        """Spheres of tables, and the pixels of them that are there: all of small ones."""
        view = SomePixels(size, _EVERY) if size > 128 else tb.SphereView(size)
        name = f"tables-{'-'.join(files)}-{probe.fingerprint[:8]}-{size}"

        def images() -> tuple[Tensor, Tensor]:
            values = torch.cat([tb.MerlTable.open(path).filled.float() for path in files.values()], 1)
            twins = [view.pack(images_of(values, probe, view, SAMPLES, seed)) for seed in _SEEDS]
            mean = (twins[0] + twins[1]) / 2
            return mean, errors_of(twins[0], mean)

        return self._kept(name, images), view

    def _kept(self, name: str, make: Callable[[], tuple[Tensor, Tensor]]) -> Reference:
        path = self.folder / f"{name}-{SAMPLES}.pt"
        if not path.is_file():
            self.folder.mkdir(parents=True, exist_ok=True)
            made = make()
            with writing(path) as temporary:
                torch.save(made, temporary)
        return Reference(*torch.load(path))
