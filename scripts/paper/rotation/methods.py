"""The methods of scripts/rotation_robustness.py: from photographs, and a light that may be wrong, to weights."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.nn.functional import one_hot

import torchbrdf as tb
from torchbrdf.estimation import PAPER_PENALTY
from torchbrdf.estimation.classes import Mixture, maximisation, subspace_coordinates
from torchbrdf.estimation.solvers import balance, prior_mean


@dataclass(frozen=True, eq=False)
class LeftOut:
    """A material that was photographed, and the library without its family.

    position  of the material in the whole library
    kept      columns of the whole library that are left
    classes   of those
    """

    name: str
    position: int
    library: tb.MaterialLibrary
    kept: Tensor
    classes: tb.MaterialClasses


@dataclass(frozen=True, eq=False)
class Lit:
    """All materials of a library under one light.

    basis  their basis images
    gram   (3, n, n)  Y^T Y, float64: all that least squares on any of the columns needs of Y
    """

    basis: tb.BasisImages
    gram: Tensor

    @classmethod
    def of(cls, basis: tb.BasisImages) -> "Lit":
        """Form the products."""
        columns = basis.packed.double().permute(1, 2, 0)
        return cls(basis, columns.mT @ columns)

    def errors(self, weights: Tensor, positions: Sequence[int]) -> Tensor:
        """|Y w - y| / |y| with y the materials at some positions themselves: weights (m, s, 3, n) -> (m, s)."""
        materials, channels = torch.arange(len(positions))[:, None], torch.arange(3)
        own = 3 * torch.tensor(positions)[:, None] + channels
        difference = weights.clone()
        difference[materials, :, channels, own] -= 1
        rows = difference.permute(2, 0, 1, 3).flatten(1, 2)
        squared = ((rows @ self.gram) * rows).sum(-1).sum(0).clamp_min(0).view(weights.shape[:2])
        return torch.sqrt(squared / self.gram[channels, own, own].sum(-1, keepdim=True))


@dataclass(frozen=True, eq=False)
class Capture:
    """Photographs of materials of a library, and what is believed of the light they were taken under.

    light        the probe, the view and the whole library
    rotation     (3, 3)  how the probe is believed to be turned; None for not at all
    belief       all materials under that light
    photographs  (m, s, 3, P) float64, of s noise levels
    left_out     of every photographed material
    """

    light: tb.HarmonicBasis
    rotation: Tensor | None
    belief: Lit
    photographs: Tensor
    left_out: Sequence[LeftOut]


@dataclass(frozen=True, eq=False)
class Found:
    """What a method makes of a capture.

    weights      (m, s, 3, n)  of the columns of the whole library, 0 for those of the material itself
    class_index  (m, s)        the chosen or most probable class
    error        (m, s)        |Y w - y|^2 under the light that the method ended with [CBP21, eq. 19]
    """

    weights: Tensor
    class_index: Tensor
    error: Tensor

    @classmethod
    def empty(cls, capture: Capture) -> "Found":
        """To be filled in."""
        m, s = capture.photographs.shape[:2]
        weights = torch.zeros(m, s, 3, capture.belief.basis.n, dtype=torch.float64)
        return cls(weights, torch.zeros(m, s, dtype=torch.int64), torch.zeros(m, s, dtype=torch.float64))


def paper(capture: Capture) -> Found:
    """[CBP21, eqs. 19, 26] with Sigma' = identity.

    Leaving a material out, or taking one class, selects rows of Y^T Y and of Y^T y.
    """
    gram = capture.belief.gram
    columns = capture.belief.basis.packed.double().transpose(0, 1)  # (3, n, P)
    pixels = capture.photographs.flatten(0, 1).transpose(0, 1)
    projections = (pixels @ columns.mT).transpose(0, 1).unflatten(0, capture.photographs.shape[:2])
    energies = capture.photographs.square().sum(-1)
    found = Found.empty(capture)
    for m, material in enumerate(capture.left_out):
        found.error[m] = float("inf")
        for j in range(material.classes.n_classes):
            members = material.kept[material.classes.members(j)]
            part = gram[:, members][:, :, members]
            weights, error = class_solution(part, projections[m][..., members], energies[m])
            better = error < found.error[m]
            found.error[m, better], found.class_index[m, better] = error[better], j
            candidate = torch.zeros_like(found.weights[m])
            candidate[..., members] = weights
            found.weights[m, better] = candidate[better]
    return found


def class_solution(gram: Tensor, projection: Tensor, energy: Tensor) -> tuple[Tensor, Tensor]:
    """Weights that minimise |Y w - y|^2 + lambda_j |w - mu'|^2 [CBP21, eqs. 25-26], by Cholesky factors.

    gram        (3, c, c)  Y^T Y of the class
    projection  (s, 3, c)  Y^T y
    energy      (s, 3)     |y|^2
    returns     (s, 3, c), and |Y w - y|^2 summed over the channels (s,)
    """
    c = gram.shape[-1]
    strength = balance(PAPER_PENALTY, energy, c)[..., None]
    factor = torch.linalg.cholesky(gram + torch.diag_embed(strength.expand(-1, -1, c)))
    target = projection + strength * prior_mean(c, like=gram)
    weights = torch.cholesky_solve(target[..., None], factor)[..., 0]
    shown = (gram @ weights[..., None])[..., 0]
    return weights, (energy + ((shown - 2 * projection) * weights).sum(-1)).sum(-1)


def auto(capture: Capture) -> Found:
    """The estimator's default, as a user without the material would call it."""
    found, basis = Found.empty(capture), capture.belief.basis
    for m, material in enumerate(capture.left_out):
        estimator = tb.BRDFEstimator(basis.subset(material.library.names), material.classes)
        result = estimator(basis.unpack(capture.photographs[m]))
        found.weights[m][..., material.kept] = result.weights.mT
        found.class_index[m], found.error[m] = result.class_index, result.error
    return found


def aligned(capture: Capture) -> Found:
    """The default after `tb.align` has found the rotation, starting from the one that is believed."""
    found, light = Found.empty(capture), capture.light
    for m, material in enumerate(capture.left_out):
        for s, photograph in enumerate(capture.photographs[m]):
            image = capture.belief.basis.unpack(photograph)
            basis = tb.align(image, light.probe, light.view, material.library, start=capture.rotation).basis
            result = tb.BRDFEstimator(basis, material.classes)(image)
            found.weights[m, s][:, material.kept] = result.weights.mT
            found.class_index[m, s], found.error[m, s] = result.class_index, result.error
    return found


@dataclass(frozen=True)
class Method:
    """A way to reconstruct.

    every   unless asked otherwise, each so many materials only: docs/results/rotation_robustness.md has what all cost
    tables  those it takes part in
    """

    reconstruct: Callable[[Capture], Found]
    every: int = 1
    tables: frozenset[int] = field(default=frozenset({1, 2}))


METHODS = {
    "paper": Method(paper, tables=frozenset({1, 2, 3})),
    "auto": Method(auto, every=2),
    "aligned": Method(aligned, every=10, tables=frozenset({1})),
}
"""By name. A further one needs an entry here, and nothing else."""


def partition(library: tb.MaterialLibrary, labels: Tensor, n_dims: int) -> tb.MaterialClasses:
    """The classes of a library whose columns were classified before: labels (n,)."""
    hard = one_hot(labels).double()
    parameters = maximisation(subspace_coordinates(library.gram, n_dims), hard, 0.0)
    norms = library.gram.diagonal().clamp_min(0).sqrt()
    return tb.MaterialClasses(Mixture(*parameters, hard, (), True), library.names, library.source, norms)
