"""From photographs to weights: every class and more priors, and what photographs say about them [CBP21, sec. VI]."""

import warnings
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any, Literal

import torch
from torch import Tensor

from torchbrdf.arguments import several
from torchbrdf.brdf import MaterialLibrary
from torchbrdf.estimation.classes import MaterialClasses
from torchbrdf.estimation.constraints import Constrained, bounds_of, constrain
from torchbrdf.estimation.image_space import ImageSpace
from torchbrdf.estimation.lobe_bounds import LobeBounds
from torchbrdf.estimation.masked_photographs import check_observation, groups_by_mask
from torchbrdf.estimation.observability import Observability, observability
from torchbrdf.estimation.posterior import PosteriorBatch
from torchbrdf.estimation.posterior_projection import SeenPriors
from torchbrdf.estimation.priors import Explanation, PriorBank, prior_variances
from torchbrdf.estimation.reconstruction import Reconstruction
from torchbrdf.estimation.rehearsal import Rehearsal, rehearse
from torchbrdf.estimation.settings import CONSTRAINTS, DEFAULT_PENALTY, PAPER_PENALTY, Constraint, Penalty
from torchbrdf.estimation.shared_buffers import SharedBuffers
from torchbrdf.estimation.smooth_errors import smooth_errors
from torchbrdf.estimation.solution import Solution
from torchbrdf.estimation.solvers import GramFactor, balance, prior_mean, ridge, ridge_lstsq
from torchbrdf.estimation.state_of_light import check_light, shortened, warn_of_light
from torchbrdf.lasting import LastMade, lasting, without_autocast
from torchbrdf.transport import BasisImages
from torchbrdf.view import Frames

Solver = Literal["factored", "lstsq"]

OUTLIER = 8.0
"""With `robust`, pixels whose residual is above this many robust standard deviations are left out."""

_ROUNDS = 5


class BRDFEstimator(SharedBuffers):
    """The BRDF of a photographed shape as a combination of basis BRDFs.

    basis       Y, the basis images under the light and from the view of the photograph; a sequence of them for several
                photographs of one material (other probes, other views, or one of them again for another exposure)
    classes     the material classes of the same library
    penalty     "auto": lambda and prior by their evidence, see `priors`; "paper" for lambda = 0.5, or lambda >= 0
                itself [CBP21, eq. 25]
    solver      for a fixed penalty. "factored": singular values and vectors of every class's basis images, computed at
                the first photograph and used for all; "lstsq": `torch.linalg.lstsq` on the augmented system, every time
    constraint  None, "nonnegative", "convex", "energy" or "lobes", see `constraints`
    library     the material library, for "energy" and "lobes" only
    robust      leave out pixels that do not fit, such as saturated and dead ones

    With a fixed penalty it minimises |Y w - y|^2 + lambda_j |w - mu'_j|^2 for each class and colour channel (eq. 26
    with Sigma' = identity) and keeps the class with the smallest |Y w - y|^2 summed over the channels (eq. 19).
    Gradients flow to the photograph. Warns where the shape shows too few normals (a plane, a cube).

    A `state_dict` holds basis images, masks, classes and the fingerprints of light and view, but no settings: penalty,
    solver, constraint and robust stay those that the estimator was made with. One that does not fit, of another library
    or size, is refused with a ValueError and changes nothing; one of another light is warned of.
    """

    packed: Tensor

    def __init__(
        self,
        basis: BasisImages | Sequence[BasisImages],
        classes: MaterialClasses,
        penalty: Penalty = DEFAULT_PENALTY,
        solver: Solver = "factored",
        constraint: Constraint | None = None,
        library: MaterialLibrary | None = None,
        robust: bool = False,
    ) -> None:
        """Check that basis and classes belong together."""
        super().__init__()
        bases = several("BRDFEstimator", "basis", basis, BasisImages, classes=(classes, MaterialClasses))
        if not bases:
            raise ValueError("basis is an empty sequence; give the basis images of each photograph")
        for one in bases:
            if (one.library, one.names) != (classes.library, classes.names):
                raise ValueError("basis images and classes come from different libraries; make both from the same one")
            if one.distrust is not None:
                warnings.warn(one.distrust, UserWarning, stacklevel=2)
        if penalty not in ("auto", "paper") and not (isinstance(penalty, int | float) and 0 <= penalty < float("inf")):
            raise ValueError(f'penalty must be "auto", "paper" or a number >= 0, got {penalty!r}')
        if solver not in ("factored", "lstsq"):
            raise ValueError(f'solver must be "factored" or "lstsq", got {solver!r}')
        if constraint is not None and constraint not in CONSTRAINTS:
            raise ValueError(f"constraint must be None or one of {', '.join(CONSTRAINTS)}, got {constraint!r}")
        if solver == "lstsq" and (penalty == "auto" or constraint is not None):
            raise ValueError('solver "lstsq" is for a fixed penalty without constraint; leave it out')
        origin = (library.source, library.names) if isinstance(library, MaterialLibrary) else None
        self._bounds = bounds_of(constraint, library if origin == (classes.library, classes.names) else None)
        self.penalty, self.solver, self.constraint, self.robust = penalty, solver, constraint, robust
        self.names, self.library = bases[0].names, bases[0].library
        self.probe, self.view = (" ".join(getattr(one, key) for one in bases) for key in ("probe", "view"))
        self.several = not isinstance(basis, BasisImages)
        self.classes = copy(classes)
        self.register_buffer("packed", bases[0].packed if len(bases) == 1 else torch.cat([b.packed for b in bases], -1))
        for i, one in enumerate(bases):
            self.register_buffer(f"mask_{i}", one.mask)
        self._factors: LastMade[list[GramFactor]] = LastMade()
        self._bank: LastMade[PriorBank] = LastMade()
        self._masked_bank: tuple[PriorBank, Tensor, PriorBank] | None = None
        self._seen_priors: LastMade[SeenPriors] = LastMade()

    def _check_state(self, state_dict: Mapping[str, Any], prefix: str) -> None:
        """Refuse a state of other materials or sizes, too; warn of one of another light."""
        check_light(state_dict, prefix, self.state_dict())
        super()._check_state(state_dict, prefix)
        warn_of_light(state_dict, prefix, self.get_extra_state())

    def get_extra_state(self) -> dict[str, str]:
        """The fingerprints of what a state_dict was made from."""
        return {"library": self.library, "names": " ".join(self.names), "probe": self.probe, "view": self.view}

    def set_extra_state(self, state: Mapping[str, str]) -> None:
        """Take over the probe and view of a state_dict."""
        self.probe, self.view = state["probe"], state["view"]

    def extra_repr(self) -> str:
        """Settings and sizes, for `repr`."""
        n, _, p = self.packed.shape
        settings = f"penalty={self.penalty!r}, solver={self.solver!r}, constraint={self.constraint!r}"
        return f"{settings}, robust={self.robust}, n={n}, pixels={p}, light={shortened(self.probe)}"

    @property
    def frames(self) -> Frames:
        """Where the pixels of each photograph lie."""
        buffers = self.named_buffers(recurse=False, remove_duplicate=False)  # two exposures share one mask
        return Frames(tuple(buffer for name, buffer in buffers if name.startswith("mask_")))

    @property
    @lasting
    def bank(self) -> PriorBank:
        """The factored priors of the whole view, made at first use and anew for other buffers."""
        return self._bank.get_or_make(self.buffers(), self._make_bank)

    def _make_bank(self) -> PriorBank:
        frames, device = self.frames, self.packed.device
        space = ImageSpace.of(self.packed, frames.sizes, smooth_errors(frames.masks))
        return PriorBank.of(
            space, prior_variances(self.classes.membership.to(device), self.classes.norms.to(device), space)
        )

    @without_autocast
    def rehearse(self, novel: BasisImages | Sequence[BasisImages]) -> Rehearsal:
        """How far off photographs of the library's own materials would be under other light, see `rehearsal`.

        novel   basis images of the same library under another light, or under several
        """
        frames = Frames(tuple(mask.cpu() for mask in self.frames.masks))
        lights = [one.to("cpu") for one in several("BRDFEstimator.rehearse", "novel", novel, BasisImages)]
        return rehearse(self.packed.cpu(), frames, lights, copy(self.classes).cpu())

    @without_autocast
    def observability(
        self, library: MaterialLibrary | None = None, novel: BasisImages | Sequence[BasisImages] = ()
    ) -> Observability:
        """What the light and the view can tell about a material, before any photograph.

        library  the one of the basis images, to tell it by cell of the BRDF, too
        novel    basis images under another light, or under several, to predict the error there
        """
        lights = several("BRDFEstimator.observability", "novel", novel, BasisImages)
        told = observability(self.bank, self.classes, library)
        return replace(told, rehearsal=self.rehearse(lights)) if lights else told

    @without_autocast
    def forward(
        self, image: Tensor | Sequence[Tensor], mask: Tensor | Sequence[Tensor | None] | None = None
    ) -> Reconstruction:
        """Reconstruct the material of photographs.

        image    (*batch, 3, H, W)  linear radiance, float32 or float64, the size of the basis images; for several
                 photographs of one material a sequence of these with the same batch axes, one for each basis
        mask     (*batch, 1, H, W) or (1, H, W)  bool, True = use; None for all pixels of the basis images; photographs
                 of one mask are solved together, every other mask costs factors of its own; a sequence
                 of these for several photographs
        returns  a Reconstruction with the same batch axes; weights and image in the precision of `image`
        Raises ValueError where sizes differ, a used pixel is not finite, all are zero, or none is left; warns where
        most of the energy is below zero.
        """
        frames = self.frames
        y, used, batch = check_observation(image, mask, frames, self.several)
        if self.robust and len(y):
            used = self._without_outliers(y, used)
            y = torch.where(used[:, None], y, 0)
        groups = groups_by_mask(used)
        solutions = [self._solve(y[rows], used[rows[0]]) for rows in groups]
        if not groups:
            solutions = [self._solve(y, torch.ones(y.shape[-1], dtype=torch.bool, device=y.device))]
        place = torch.empty(len(y), 2, dtype=torch.int64, device=y.device)
        for i, rows in enumerate(groups):
            place[rows] = torch.stack([torch.full_like(rows, i), torch.arange(len(rows), device=y.device)], -1)

        def gathered(name: str) -> Tensor:
            parts = [getattr(one, name) for one in solutions]
            return parts[0] if len(parts) == 1 else torch.cat(parts)[torch.argsort(torch.cat(groups))]

        errors, probabilities = gathered("errors"), gathered("probabilities")

        def shaped(values: Tensor, dtype: torch.dtype = y.dtype) -> Tensor:
            return values.to(dtype).reshape((*batch, *values.shape[1:]))

        images = tuple(shaped(one) for one in frames.unpack(gathered("fitted")))
        evidence = tuple(one.evidence for one in solutions if one.evidence is not None)
        return Reconstruction(
            weights=shaped(gathered("weights")),
            class_weights=shaped(gathered("class_weights")),
            class_errors=shaped(errors[:, 1:], torch.float64),
            class_probabilities=shaped(probabilities),
            class_index=shaped(probabilities.argmax(1), torch.int64),
            error=shaped(errors[:, 0], torch.float64),
            energy=shaped(_squared_norm(y), torch.float64),
            image=images if self.several else images[0],
            names=self.names,
            library=self.library,
            posteriors=PosteriorBatch(evidence, place.reshape(*batch, 2)) if evidence else None,
            optimality=None if self.constraint is None else shaped(gathered("optimality")),
        )

    def _without_outliers(self, y: Tensor, used: Tensor) -> Tensor:
        """Leave out pixels whose residual no other explains, until they stay the same."""
        kept = used
        with torch.no_grad():
            scale = self.bank.space.scale.to(y.dtype)
            scale = torch.where(scale > 0, scale, 1)
            for _ in range(_ROUNDS):
                found = []
                for b in range(len(y)):
                    fitted = self._fitted(y[b : b + 1], kept[b])[0]
                    residual = ((fitted - y[b]) / scale).abs().amax(0)
                    spread = residual[kept[b]].median() / 0.6745
                    found.append(used[b] & (residual <= OUTLIER * spread))
                new = torch.stack(found)
                lit = ((y != 0) & new[:, None]).flatten(1).any(1)  # what fits may be black, and black fits anything
                new = torch.where(lit[:, None], new, kept)
                if torch.equal(new, kept):
                    break
                kept = new
        return kept

    def _fitted(self, y: Tensor, used: Tensor) -> Tensor:
        """What the weights show (B, 3, P); of the average without candidates and constraint, which cost more."""
        if self.penalty == "auto":
            return self.bank.space.render(self._bank_of(used).explain(y[..., used]).mean, y.dtype)
        return self._choose(y.double(), used).fitted

    def _solve(self, y: Tensor, used: Tensor) -> Solution:
        """Photographs y (B, 3, P) that share the pixels used (P,)."""
        return self._average(y, used) if self.penalty == "auto" else self._choose(y.double(), used)

    def _average(self, y: Tensor, used: Tensor) -> Solution:
        """Posterior mean over all priors and penalties."""
        bank, whole = self._bank_of(used), bool(used.all())
        found = bank.explain(y if whole else y[..., used])
        k = self.classes.n_classes
        weights, class_weights = found.mean_and_first(k)
        optimality = weights.new_zeros(len(weights), 3)
        if self.constraint is not None and len(weights):
            closest = self._within(self.constraint, found, weights)
            weights, optimality = closest.weights, closest.optimality
        fitted = (bank if whole else self.bank).space.render(weights, y.dtype)
        residual = y - fitted if whole else (y - fitted)[..., used]
        error = _squared_norm(residual)[:, None]
        growth = bank.space.growth(residual, weights[:, None] - class_weights)
        return Solution(
            weights=weights.mT,
            class_weights=class_weights.mT,
            fitted=fitted,
            errors=torch.cat([error, (error + growth).clamp_min(0)], 1),
            probabilities=found.of_classes(k),
            optimality=optimality,
            evidence=found.detach(),
        )

    def _within(self, constraint: Constraint, found: Explanation, mean: Tensor) -> Constrained:
        """The constrained weights nearest to the mean.

        In a metric of the averaged prior; of highlights photographs tell too little for less than the posterior itself.
        """
        if isinstance(self._bounds, LobeBounds):
            bounds, bank = self._bounds, found.bank
            seen = self._seen_priors.get_or_make([bank.vectors], lambda: SeenPriors.of(bank, bounds))
            return seen.project(found, mean)
        return constrain(mean, found.precision(found.shares), constraint, self._bounds)

    @lasting
    def _bank_of(self, used: Tensor) -> PriorBank:
        """The priors in the space of the pixels used; the last mask is remembered."""
        whole = self.bank
        if bool(used.all()):
            return whole
        last = self._masked_bank  # another thread may replace it
        if last is None or last[0] is not whole or not torch.equal(last[1], used):
            last = self._masked_bank = whole, used, whole.masked(used)
        return last[2]

    def _choose(self, y: Tensor, used: Tensor) -> Solution:
        """One solve per class with a fixed penalty; the best class wins [CBP21, eqs. 19, 26]."""
        whole = bool(used.all())
        basis = self.packed if whole else self.packed[..., used]
        seen = y[..., used]
        energy = seen.square().sum(-1)
        factors = self._class_factors(basis, cached=whole) if self.solver == "factored" else None
        class_weights = y.new_zeros(len(y), self.classes.n_classes, self.packed.shape[0], 3)
        optimality = y.new_zeros(len(y), self.classes.n_classes, 3)
        penalty = PAPER_PENALTY if self.penalty == "paper" else float(self.penalty)
        for j in range(self.classes.n_classes):
            members = self.classes.members(j)
            prior = prior_mean(len(members), like=y)
            strength = balance(penalty, energy, len(members))
            if factors is None:
                solution = ridge_lstsq(basis[members], seen, prior, strength)
            else:
                projection = torch.einsum("nsp,bsp->bsn", basis[members].double(), seen)
                solution = ridge(factors[j], projection, prior, strength)
                if self.constraint is not None and len(y):
                    bounds = None if self._bounds is None else self._bounds.select(members)
                    closest = constrain(solution, factors[j].precision(strength), self.constraint, bounds)
                    solution, optimality[:, j] = closest.weights, closest.optimality
            class_weights[:, j, members] = solution.mT
        fitted = torch.einsum("bkns,nsp->bksp", class_weights, self.packed.double())
        errors = torch.where(used, fitted - y[:, None], 0).square().sum((-2, -1))
        best, row = errors.argmin(1), torch.arange(len(y), device=y.device)
        return Solution(
            weights=class_weights[row, best],
            class_weights=class_weights,
            fitted=fitted[row, best],
            errors=torch.cat([errors[row, best][:, None], errors], 1),
            probabilities=torch.nn.functional.one_hot(best, self.classes.n_classes).to(y.dtype),
            optimality=optimality[row, best],
        )

    @lasting
    def _class_factors(self, basis: Tensor, cached: bool) -> list[GramFactor]:
        """The factors of all classes; those of the unmasked basis are made once, and anew for other buffers."""
        if cached:
            return self._factors.get_or_make(self.buffers(), lambda: self._class_factors(basis, cached=False))
        return [GramFactor.of(basis[self.classes.members(j)]) for j in range(self.classes.n_classes)]


def _squared_norm(image: Tensor) -> Tensor:
    """Sum of squares over the last two axes, in float64."""
    return torch.linalg.vector_norm(image, dim=(-2, -1), dtype=torch.float64).square()
