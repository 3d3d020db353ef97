"""What the estimator found: weights, the class that won, and every class's candidate."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchbrdf.arguments import check_types
from torchbrdf.brdf import MaterialLibrary, MerlTable, above_horizon
from torchbrdf.estimation.posterior import Posterior, PosteriorBatch
from torchbrdf.transport import BasisImages

_SAMPLED = 61
"""One cell in so many tells which directions of the weights matter to all cells."""


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction:
    """Reconstructions of a batch of photographs; every tensor starts with the batch axes.

    weights        (*batch, n, 3)     rho = B w, one column a colour channel [CBP21, eq. 1]
    class_weights  (*batch, K, n, 3)  the candidate of every class, 0 for basis BRDFs of other classes
    class_errors   (*batch, K)        |Y w - y|^2 of every candidate over the pixels used [CBP21, eq. 19]; squares are
                                      float64 whatever the photograph's precision, in which those of 1e20 have no place
    class_probabilities (*batch, K)   of the classes, given that the material is of one of them; with a fixed penalty,
                                      which has no probabilities, 1 for the class that was chosen
    class_index    (*batch)           int64, the most probable class
    error          (*batch)           |Y w - y|^2 of the weights, float64
    energy         (*batch)           |y|^2 over the pixels used, float64
    image          (*batch, 3, H, W)  Y w: the photograph as the weights explain it; a tuple of them for several
                                      photographs of one material
    names          the materials behind the n = 3 len(names) weights
    library        fingerprint of their columns
    posteriors     what the photographs leave open, see `posterior`; None with a fixed penalty
    optimality     (*batch, 3)        residual of the constrained solve; None without a constraint

    With a fixed penalty the weights are those of the chosen class; with penalty="auto" they are the posterior mean over
    classes, the whole library and neighbourhoods in it.
    """

    weights: Tensor
    class_weights: Tensor
    class_errors: Tensor
    class_probabilities: Tensor
    class_index: Tensor
    error: Tensor
    energy: Tensor
    image: Tensor | tuple[Tensor, ...]
    names: tuple[str, ...]
    library: str
    posteriors: PosteriorBatch | None = None
    optimality: Tensor | None = None

    @property
    def relative_error(self) -> Tensor:
        """(*batch): |Y w - y| / |y| in the photograph's precision. Small does not mean right: see `posterior`."""
        share = self.error / self.energy
        perfect = share == 0  # no gradient from a residual of 0
        return torch.where(perfect, 0, torch.where(perfect, 1, share).sqrt()).to(self.weights.dtype)

    def __repr__(self) -> str:
        """Which class, how probable, how much of the photograph is left; of a batch how many there are."""
        batch, classes = tuple(self.class_index.shape), self.class_errors.shape[-1]
        if batch:
            return f"Reconstruction({' x '.join(map(str, batch))} photographs, {classes} classes)"
        index = int(self.class_index)
        probable = f"class {index} of {classes} ({float(self.class_probabilities[index].detach()):.0%})"
        return f"Reconstruction({probable}, relative error {float(self.relative_error.detach()):.2%})"

    def __len__(self) -> int:
        """The size of the first batch axis."""
        if self.class_index.ndim == 0:
            raise TypeError("a single reconstruction has no length")
        return len(self.class_index)

    def __getitem__(self, i: int) -> "Reconstruction":
        """One reconstruction of a batch."""
        if self.class_index.ndim == 0:
            raise IndexError("this is a single reconstruction; it has no batch axis to index")
        picked = self._each(lambda tensor: tensor[i])
        return picked if self.posteriors is None else replace(picked, posteriors=self.posteriors[i])

    def detach(self) -> "Reconstruction":
        """The same tensors without gradients, as `Tensor.detach`; posteriors never have any."""
        return self._each(Tensor.detach)

    def to(self, device: torch.device | str) -> "Reconstruction":
        """On another device, there `without_posteriors`, which are where the estimator is."""
        moved = self._each(lambda tensor: tensor.to(device))
        return moved if moved.weights.device == self.weights.device else moved.without_posteriors()

    def without_posteriors(self) -> "Reconstruction":
        """The same without what `posterior`, `image_std` and `brdf_std` need, which then raise ValueError.

        To keep many results or to save them: posteriors refer to the factored priors of the estimator, some 30 MB that
        every pickle would hold. Gradients stay: `result.detach().without_posteriors()`.
        """
        kept = self.posteriors
        return self if kept is None else replace(self, posteriors=PosteriorBatch((), kept.where))

    def _each(self, change: Callable[[Tensor], Tensor]) -> "Reconstruction":
        """With every tensor changed; posteriors stay."""
        return replace(
            self,
            weights=change(self.weights),
            class_weights=change(self.class_weights),
            class_errors=change(self.class_errors),
            class_probabilities=change(self.class_probabilities),
            class_index=change(self.class_index),
            error=change(self.error),
            energy=change(self.energy),
            image=tuple(map(change, self.image)) if isinstance(self.image, tuple) else change(self.image),
            optimality=None if self.optimality is None else change(self.optimality),
        )

    def candidate(self, j: int, library: MaterialLibrary) -> MerlTable:
        """The BRDF that class j would give; see `brdf`."""
        self.check_library(library, "Reconstruction.candidate")
        return library.combine(self.class_weights[j], f"class {j}")

    def brdf(self, library: MaterialLibrary) -> MerlTable:
        """The full table rho = B w, cells below zero set to zero.

        No gradient flows through it, of which it warns; for a loss under other light use `basis.render(weights)`.
        Raises ValueError for a batch (pick one with result[i]) or another library than that of the basis images.
        """
        self.check_library(library, "Reconstruction.brdf")
        return library.combine(self.weights, "reconstruction")

    def tables(self, library: MaterialLibrary, keep: bool = True) -> list[MerlTable]:
        """`brdf` and then every class's `candidate`, in the time of little more than one of them.

        keep  whether the library's columns stay in memory, see `StoredColumns.blocks`
        """
        self.check_library(library, "Reconstruction.tables")
        weights = torch.cat([self.weights[None], self.class_weights])
        names = ["reconstruction", *(f"class {j}" for j in range(len(weights) - 1))]
        return library.combine_each(weights, names, keep)

    def image_std(self, basis: BasisImages) -> Tensor:
        """(3, H, W): standard deviation of every pixel of the material rendered with basis images of any probe.

        The pixel is within 1.645 of these of the rendering of `weights` with a probability of 90 %; see
        docs/uncertainty.md for how often that held. 0 outside the mask. No gradient flows through it.
        """
        check_types("Reconstruction.image_std", basis=(basis, BasisImages))
        if (basis.library, basis.names) != (self.library, self.names):
            raise ValueError("these basis images show another library than those of the photograph")
        return basis.unpack(self.posterior.std(basis.packed.permute(1, 2, 0)))

    def brdf_std(self, library: MaterialLibrary) -> Tensor:
        """(90, 90, 180, 3) float32: standard deviation of f_r in every cell of `brdf`, in 1/sr, 0 below the horizon."""
        self.check_library(library, "Reconstruction.brdf_std")
        posterior = self.posterior
        some = torch.nonzero(above_horizon().ravel()).ravel()[::_SAMPLED]
        factor = posterior.compressed(library.rows(some))
        return library.map_rows(lambda rows: posterior.std(rows, factor).T)

    @property
    def posterior(self) -> Posterior:
        """The posterior of the weights, of a single reconstruction.

        Raises ValueError for a batch, for a result `without_posteriors`, and with a fixed penalty, which has none.
        """
        self._single("posterior")
        if self.posteriors is None:
            raise ValueError('a fixed penalty has no posterior; make the estimator with penalty="auto"')
        return self.posteriors.single

    def check_library(self, library: MaterialLibrary, call: str) -> None:
        """Raise ValueError for a batch, or another library than that of the basis images.

        call  what needs a single reconstruction and its library, as messages name it
        """
        self._single(call)
        check_types(call, library=(library, MaterialLibrary))
        if (library.source, library.names) != (self.library, self.names):
            raise ValueError("this library is not the one that the basis images were rendered with")

    def _single(self, what: str) -> None:
        if self.class_index.ndim:
            raise ValueError(
                f"{what} needs a single reconstruction, this holds a batch {tuple(self.class_index.shape)}; "
                "pick one: result[i]"
            )
