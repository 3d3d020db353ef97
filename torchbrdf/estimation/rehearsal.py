"""A rehearsal: what the estimator would make of photographs that were not taken yet.

Every material of the library is photographed as its basis images show it, with errors as captures have them, recovered
from the library without it and its neighbours in the alphabet (names of a paint line begin alike), and shown under
other light. How far it is off then is what to expect of a material that is no stranger than these are to each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import torch
from torch import Tensor

from torchbrdf.estimation.classes import MaterialClasses
from torchbrdf.estimation.image_space import ImageSpace
from torchbrdf.estimation.priors import PriorBank, prior_variances
from torchbrdf.estimation.smooth_errors import smooth_errors
from torchbrdf.transport import BasisImages, own_images
from torchbrdf.view import Frames

Kind = Literal["dull", "glossy", "mirror-like"]
KINDS: tuple[Kind, ...] = get_args(Kind)
"""Thirds of the library by |b|, which the peak of the highlight rules."""

NOISE, SHARED = 0.01, 0.02
"""Standard deviations of a pixel's own error and of the one that it shares with its neighbours, shares of its radiance.
Of 1 and 2 % shared, 2 brings the mean over lights nearer to that of measured materials (docs/uncertainty.md)."""

_FOLDS = 6
_SEED = 2718


@dataclass(frozen=True, eq=False, repr=False)
class Rehearsal:
    """Errors of the library's materials.

    errors  (m, lights)  |shown - true| / |true| under each of the other lights, 1 at most
    kinds   (m,) int64   which of KINDS
    """

    errors: Tensor
    kinds: Tensor

    def __repr__(self) -> str:
        """How many materials and lights, and the mean error."""
        materials, lights = self.errors.shape
        return f"Rehearsal({materials} materials, {lights} other lights, mean error {self.error:.2%})"

    @property
    def error(self) -> float:
        """The mean."""
        return float(self.errors.mean())

    @property
    def by_kind(self) -> dict[Kind, float]:
        """The mean of each kind that the library holds."""
        means = ((kind, self.errors[self.kinds == i]) for i, kind in enumerate(KINDS))
        return {kind: float(some.mean()) for kind, some in means if len(some)}


def rehearse(packed: Tensor, frames: Frames, novel: Sequence[BasisImages], classes: MaterialClasses) -> Rehearsal:
    """Of one photograph a material, or of several.

    packed   (n, 3, P)  basis images of the photographs, one behind the other
    frames   where their pixels lie
    novel    basis images under other light, from any view
    Raises ValueError where there are none, for other libraries than that of the classes, and for fewer than two
    materials.
    """
    if not novel:
        raise ValueError("a rehearsal shows materials under other light: give basis images under one at least")
    if any((one.library, one.names) != (classes.library, classes.names) for one in novel):
        raise ValueError("basis images and classes come from different libraries; make all from the same one")
    if len(classes.names) < 2:
        raise ValueError("a rehearsal recovers each material from others, and this library holds one")
    errors = smooth_errors(frames.masks)
    space = ImageSpace.of(packed, frames.sizes, errors)
    y = _photographs(packed, errors)
    weights = packed.new_zeros(len(y), 3, len(packed))
    for rows in _folds(classes.names):
        kept = torch.ones(len(y), dtype=torch.bool)
        kept[rows] = False
        columns = kept.repeat_interleave(3)
        some = replace(space, r=space.r[..., columns])
        members = classes.membership[:, columns]
        variances = prior_variances(members[members.any(1)], classes.norms[columns], some)
        found = PriorBank.of(some, variances).explain(y[rows]).mean
        weights[rows[:, None, None], torch.arange(3)[:, None], torch.nonzero(columns).ravel()] = found.float()
    return Rehearsal(torch.stack([_errors(one.packed, weights) for one in novel], 1), _kinds(classes.norms))


def _photographs(packed: Tensor, errors: Tensor) -> Tensor:
    """(m, 3, P): what basis images (3 m, 3, P) show of each material, with errors of both kinds, always the same."""
    own = own_images(packed)
    generator = torch.Generator().manual_seed(_SEED)
    drawn = torch.randn(len(own), errors.shape[1], 1, generator=generator, dtype=torch.float64)
    size = errors.square().sum(1).max().sqrt()
    shared = (SHARED / size * errors @ drawn)[..., 0][:, None]
    return own * (1 + shared + NOISE * torch.randn(own.shape, generator=generator, dtype=torch.float32))


def _errors(packed: Tensor, weights: Tensor) -> Tensor:
    """(m,) of weights (m, 3, n) under another light."""
    true = own_images(packed)
    shown = torch.einsum("mcn,ncp->mcp", weights, packed)
    size = true.flatten(1).norm(dim=1)
    return ((shown - true).flatten(1).norm(dim=1) / torch.where(size > 0, size, 1)).clamp_max(1)


def _folds(names: Sequence[str]) -> list[Tensor]:
    """Materials that are left out together."""
    order = sorted(range(len(names)), key=lambda i: names[i].rsplit("/", 1)[-1].lower())
    return list(torch.tensor(order).tensor_split(min(_FOLDS, len(names))))


def _kinds(norms: Tensor) -> Tensor:
    """(m,) int64 of norms |b_i| of all columns."""
    ranks = norms.view(-1, 3).mean(1).argsort().argsort()
    return ranks * len(KINDS) // len(ranks)
