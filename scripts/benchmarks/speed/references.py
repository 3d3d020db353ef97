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
from harmonic import reference_of
from speed.inputs import images_of
from torchbrdf.experiments import relative
from torchbrdf.files import writing

BASIS_SAMPLES, TABLE_SAMPLES = 32768, 131072
_SEEDS = (9100, 9101)
_WHOLE = 128
"""Pixels across up to which all of a picture is compared."""

_EVERY, _BRIGHT, _LOOK = 8, 1000, 256
"""Of larger ones: one row and column in so many, and the brightest pixels of a first look with so many samples."""


class SomePixels(tb.SphereView):
    """A sphere of which only some pixels are looked at."""

    def __init__(self, size: int, kept: Tensor) -> None:
        """Leave those that are not kept (1, H, W) out of the mask."""
        super().__init__(size)
        self.mask = self.mask & kept


@dataclass(frozen=True)
class Reference:
    """Converged images.

    view     which pixels of them are there
    images   (n, 3, P)
    own      (n,) how far one of the two runs is from their mean
    weights  (P,) for how many pixels each stands
    """

    view: tb.View
    images: Tensor
    own: Tensor
    weights: Tensor

    def errors(self, found: Tensor) -> Tensor:
        """(n,) relative RMS errors of images (n, 3, P)."""
        return relative(found * self.weights.sqrt(), self.images * self.weights.sqrt())


@dataclass(frozen=True)
class References:
    """The folder."""

    folder: Path

    def basis(self, library: tb.MaterialLibrary, probe: tb.LightProbe, view: tb.View) -> Reference:
        """All basis images."""
        name = f"basis-{library.source[:8]}-{len(library)}-{probe.fingerprint[:8]}-{view.fingerprint[:8]}"

        def images() -> tuple[Tensor, ...]:
            return view.mask, *reference_of(library, probe, view, BASIS_SAMPLES), torch.ones(len(view.pixels))

        return self._kept(f"{name}-{BASIS_SAMPLES}", view.size[0], images)

    def tables(self, files: Mapping[str, Path], probe: tb.LightProbe, size: int) -> Reference:
        """Spheres of tables."""

        def images() -> tuple[Tensor, ...]:
            values = torch.cat([tb.MerlTable.open(path).filled.float() for path in files.values()], 1)
            weights = torch.ones(1, size, size) if size <= _WHOLE else _weights(values, probe, size)
            view = SomePixels(size, weights > 0)
            twins = [view.pack(images_of(values, probe, view, TABLE_SAMPLES, seed)) for seed in _SEEDS]
            mean, roots = (twins[0] + twins[1]) / 2, view.pack(weights).sqrt()
            return view.mask, mean, relative(twins[0] * roots, mean * roots), view.pack(weights)[0]

        return self._kept(f"tables-{'-'.join(files)}-{probe.fingerprint[:8]}-{size}-{TABLE_SAMPLES}", size, images)

    def _kept(self, name: str, size: int, make: Callable[[], tuple[Tensor, ...]]) -> Reference:
        path = self.folder / f"{name}.pt"
        if not path.is_file():
            self.folder.mkdir(parents=True, exist_ok=True)
            made = make()
            with writing(path) as temporary:
                torch.save(made, temporary)
        mask, images, own, weights = torch.load(path)
        return Reference(SomePixels(size, mask), images, own, weights)


def _weights(values: Tensor, probe: tb.LightProbe, size: int) -> Tensor:
    """(1, H, W): 1 for the brightest pixels, those of mirrored lamps; of others one in a few stands for its like."""
    look = images_of(values, probe, tb.SphereView(size), _LOOK).square().sum(1)
    share = (look / look.sum((1, 2), keepdim=True)).amax(0)
    weights = torch.zeros_like(share)
    weights[_EVERY // 2 :: _EVERY, _EVERY // 2 :: _EVERY] = _EVERY**2
    weights[share >= share.flatten().topk(_BRIGHT).values[-1]] = 1
    return weights[None]
