"""What scripts/benchmarks/solver.py measures on, and a line of what it prints."""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf.estimation import DEFAULT_PENALTY, Penalty


@dataclass(frozen=True)
class Row:
    """One line: what was timed, seconds of every repeat, and for how many photographs; the rest is text."""

    part: str
    what: str
    seconds: Sequence[float] = ()
    photographs: int = 1
    fitted: float | None = None
    novel: float | None = None
    remark: str = ""

    @property
    def median(self) -> float:
        """Milliseconds a photograph."""
        return 1e3 * statistics.median(self.seconds) / self.photographs

    def noted(self, apart: tuple[float, float], remark: str = "") -> "Row":
        """With the errors of the fitted image and of the one under the other light."""
        return replace(self, fitted=apart[0], novel=apart[1], remark=remark)

    def cells(self) -> list[str]:
        """As the table prints it."""
        ordered = sorted(self.seconds)
        ends = [1e3 * ordered[round(q * (len(ordered) - 1))] / self.photographs for q in (0.1, 0.9)] if ordered else []
        clock = [f"{self.median:.3f}", f"{ends[0]:.3f}-{ends[1]:.3f}"] if ordered else ["", ""]
        errors = ["" if error is None else f"{error:.1e}" for error in (self.fitted, self.novel)]
        return [self.part, self.what, *clock, *errors, self.remark]


@dataclass(frozen=True)
class Scene:
    """Basis images under a light and under another, classes, and noisy photographs (B, 3, H, W) of materials."""

    library: tb.MaterialLibrary
    probe: tb.LightProbe
    view: tb.SphereView
    basis: tb.BasisImages
    novel: tb.BasisImages
    classes: tb.MaterialClasses
    photographs: Tensor
    repeats: int

    @classmethod
    def of(
        cls, library: tb.MaterialLibrary, probe: tb.LightProbe, size: int, samples: int, repeats: int, count: int = 256
    ) -> "Scene":
        """Photographs: the materials of the library in turn, with 1 % of noise."""
        view = tb.SphereView(size)
        turned = probe.rotated(torch.diag(torch.tensor([-1.0, 1.0, -1.0])))
        basis, novel = (tb.render_basis(library, light, view, samples=samples) for light in (probe, turned))
        g = torch.Generator().manual_seed(0)
        channels = basis.packed.unflatten(0, (-1, 3))
        own = torch.stack([channels[:, c, c] for c in range(3)], 1)[torch.arange(count) * 37 % len(library.names)]
        noisy = own * (1 + 0.01 * torch.randn(own.shape, generator=g))
        return cls(library, probe, view, basis, novel, tb.MaterialClasses.fit(library), basis.unpack(noisy), repeats)

    def estimator(self, penalty: Penalty = DEFAULT_PENALTY) -> tb.BRDFEstimator:
        """One that has its factors."""
        estimator = tb.BRDFEstimator(self.basis, self.classes, penalty)
        with torch.no_grad():
            estimator(self.photographs[0])
        return estimator

    def timed(self, work: Callable[[], object], least: int = 3) -> list[float]:
        """Seconds of every repeat, after a warm-up."""
        for _ in range(3):
            work()
        seconds = []
        for _ in range(max(least, self.repeats)):
            start = time.perf_counter()
            work()
            seconds.append(time.perf_counter() - start)
        return seconds

    def apart(self, weights: Tensor, reference: Tensor) -> tuple[float, float]:
        """How far renderings of weights (B, n, 3) are from those of others: fitted, and under the other light."""
        pairs = []
        for basis in (self.basis, self.novel):
            a, b = (basis.render(w.double()) for w in (weights, reference))
            pairs.append(float((a - b).norm() / b.norm()))
        return pairs[0], pairs[1]

    def pixels(self, count: int) -> Tensor:
        """Photographs (count, 3, P) float64 over the pixels of the view."""
        return self.basis.pack(self.photographs[:count]).double()
