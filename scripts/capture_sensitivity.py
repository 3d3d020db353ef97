"""What spoils a capture: the table of docs/capture_guide.md.

Run `python scripts/capture_sensitivity.py`; it needs no data. Materials of the embedded library are photographed
under the default light probe with one defect at a time, recovered from the other 99, and compared with the truth
under another light.
"""

import math
from collections.abc import Callable, Iterator

import torch
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb

MATERIALS = (
    "alum-bronze", "blue-acrylic", "cherry-235", "chrome-steel", "gold-metallic-paint2", "green-latex", "nickel",
    "pink-fabric", "red-plastic", "specular-blue-phenolic", "teflon", "white-marble",
)  # fmt: skip
SIZE = 64

Defect = Callable[[tb.MerlTable, tb.LightProbe, tb.View], tuple[Tensor, Tensor]]
"""A photograph (3, N, N) and the mask of its usable pixels (1, N, N)."""


def _rotation(axis: Tensor, angle: float) -> Tensor:
    x, y, z = axis.tolist()
    generator = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    return torch.linalg.matrix_exp(angle * generator)


def turned(degrees: float) -> Defect:
    """The photograph was taken under a light turned about an oblique axis."""
    rotation = _rotation(torch.tensor([1.0, 2.0, 2.0]) / 3, math.radians(degrees))
    return lambda table, probe, view: (tb.render(table, probe.rotated(rotation), view, seed=1), view.mask)


def noisy(relative: float) -> Defect:
    """Gaussian noise, relative to the mean of the photograph."""

    def photograph(table: tb.MerlTable, probe: tb.LightProbe, view: tb.View) -> tuple[Tensor, Tensor]:
        clean = tb.render(table, probe, view, seed=1)
        noise = torch.randn(clean.shape, generator=torch.Generator().manual_seed(0))
        return clean + relative * view.pack(clean).mean() * noise, view.mask

    return photograph


def saturated(masked: bool) -> Defect:
    """The brightest 2 % of the pixels are clipped, and masked out or not."""

    def photograph(table: tb.MerlTable, probe: tb.LightProbe, view: tb.View) -> tuple[Tensor, Tensor]:
        clean = tb.render(table, probe, view, seed=1)
        limit = torch.quantile(view.pack(clean).amax(0), 0.98)
        mask = view.mask & (clean.amax(0, keepdim=True) < limit) if masked else view.mask
        return clean.clamp_max(limit), mask

    return photograph


def exposed(factor: float) -> Defect:
    """The photograph is brighter than the probe says."""
    return lambda table, probe, view: (factor * tb.render(table, probe, view, seed=1), view.mask)


DEFECTS: dict[str, Defect] = {
    "none": turned(0),
    **{f"light turned by {angle} degrees": turned(angle) for angle in (0.25, 0.5, 1, 2, 5)},
    **{f"noise of {level:.0%} of the mean": noisy(level) for level in (0.01, 0.05)},
    "brightest 2 % of the pixels clipped": saturated(masked=False),
    "the same, clipped pixels masked": saturated(masked=True),
    "exposure wrong by 10 %": exposed(1.1),
}


def errors() -> Iterator[tuple[str, list[float]]]:
    """For each material, the errors under a new light, a defect each."""
    whole = tb.MaterialLibrary.default()
    probe, view = tb.LightProbe.default(), tb.SphereView(SIZE)
    novel = probe.rotated(torch.diag(torch.tensor([-1.0, 1.0, -1.0])))
    basis, novel_basis = (tb.render_basis(whole, light, view, progress=True) for light in (probe, novel))
    for name in tqdm(MATERIALS):
        library = whole.without(name)
        estimate = tb.BRDFEstimator(basis.without(name), tb.MaterialClasses.fit(library))
        truth = whole.table(name)
        expected = novel_basis.pack(tb.render(truth, novel, view, seed=1))
        found = []
        for defect in DEFECTS.values():
            weights = estimate(*defect(truth, probe, view)).weights
            got = torch.einsum("nc,ncp->cp", weights, novel_basis.without(name).packed)
            found.append(float((got - expected).norm() / expected.norm()))
        yield name, found


def main() -> None:
    """Print the table: median and worst over the materials."""
    table = torch.tensor([found for _, found in errors()])
    print("| defect | median error | worst |\n|---|---|---|")
    for defect, column in zip(DEFECTS, table.T, strict=True):
        print(f"| {defect} | {column.median():.3f} | {column.max():.3f} |")


if __name__ == "__main__":
    main()
