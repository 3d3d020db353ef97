"""What spoils a capture, and which setting stands it: the table of docs/results/capture_defects.md.

Run `python scripts/benchmarks/capture_sensitivity.py`; it needs no data. Materials of the embedded library are
photographed under the default light probe with one defect at a time, recovered from the others, and compared with the
truth under another light.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb
from torchbrdf.experiments import tilt

MATERIALS = (
    "alum-bronze", "blue-acrylic", "cherry-235", "chrome-steel", "gold-metallic-paint2", "green-latex", "nickel",
    "pink-fabric", "red-plastic", "specular-blue-phenolic", "teflon", "white-marble",
)  # fmt: skip
SIZE = 64
Spoil = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""From a clean photograph (3, N, N) and the mask of its view (1, N, N) to what the estimator gets."""


def clean(image: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """Nothing is wrong."""
    return image, mask


def noisy(level: float) -> Spoil:
    """Gaussian noise, relative to the mean of the photograph."""

    def spoil(image: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        noise = torch.randn(image.shape, generator=torch.Generator().manual_seed(0))
        return image + level * image[:, mask[0]].mean() * noise, mask

    return spoil


def clipped(masked: bool) -> Spoil:
    """The brightest 2 % of the pixels are clipped, and masked out or not."""

    def spoil(image: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        peak = image.amax(0, keepdim=True)
        limit = torch.quantile(peak[mask], 0.98)
        return image.clamp_max(limit), mask & (peak < limit) if masked else mask

    return spoil


def brighter(factor: float) -> Spoil:
    """Probe and photograph are not in the same units."""
    return lambda image, mask: (factor * image, mask)


@dataclass(frozen=True)
class Defect:
    """The photograph was taken under a light turned by `degrees` about AXIS, and then spoilt."""

    degrees: float = 0
    spoil: Spoil = clean


DEFECTS = {
    "none": Defect(),
    **{f"light turned by {degrees} degrees": Defect(degrees=degrees) for degrees in (0.25, 0.5, 1, 2, 5)},
    **{f"noise of {percent} % of the mean": Defect(spoil=noisy(percent / 100)) for percent in (1, 5)},
    "brightest 2 % of the pixels clipped": Defect(spoil=clipped(masked=False)),
    "the same, clipped pixels masked": Defect(spoil=clipped(masked=True)),
    "photograph 10 % too bright": Defect(spoil=brighter(1.1)),
}


SETTINGS: dict[str, dict[str, Any]] = {
    "default": {},
    "robust": {"robust": True},
    "w >= 0": {"constraint": "nonnegative"},
    "convex": {"constraint": "convex"},
    "paper": {"penalty": "paper"},
}
"""Arguments of BRDFEstimator."""


def errors() -> Tensor:
    """(materials, defects, settings): |rendered - truth| / |truth| under the new light."""
    whole = tb.MaterialLibrary.default()
    probe, view = tb.LightProbe.default(), tb.SphereView(SIZE)
    basis = tb.render_basis(whole, probe, view, progress=True)
    half_turn = torch.diag(torch.tensor([-1.0, 1.0, -1.0]))
    novel = tb.render_basis(whole, probe.rotated(half_turn), view, progress=True)
    photographs = {
        degrees: tb.render_basis(whole, probe.rotated(tilt(degrees)), view, seed=1, progress=True).subset(MATERIALS)
        for degrees in {defect.degrees for defect in DEFECTS.values()}
    }
    found = torch.empty(len(MATERIALS), len(DEFECTS), len(SETTINGS))
    for i, name in enumerate(tqdm(MATERIALS)):
        without, classes = basis.without(name), tb.MaterialClasses.fit(whole.without(name))
        expected, others = novel.image(name), novel.without(name)
        for k, setting in enumerate(SETTINGS.values()):
            estimate = tb.BRDFEstimator(without, classes, **setting)
            for j, defect in enumerate(DEFECTS.values()):
                photograph = photographs[defect.degrees].image(name)
                got = others.render(estimate(*defect.spoil(photograph, view.mask)).weights)
                found[i, j, k] = (got - expected).norm() / expected.norm()
    return found


def main() -> None:
    """Print the table: median / worst over the materials."""
    print(f"| defect | {' | '.join(SETTINGS)} |\n|---|{'---|' * len(SETTINGS)}")
    for name, columns in zip(DEFECTS, errors().transpose(0, 1), strict=True):
        cells = [f"{column.median():.3f} / {column.max():.3f}" for column in columns.T]
        print(f"| {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
