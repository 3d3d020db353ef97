"""Material classes: a Gaussian mixture over the space of BRDFs [CBP21, sec. IV]."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from math import log, pi

import torch
from torch import Tensor

from torchbrdf.arguments import check_types
from torchbrdf.brdf import MaterialLibrary
from torchbrdf.estimation.settings import N_CLASSES, N_DIMS
from torchbrdf.estimation.shared_buffers import SharedBuffers
from torchbrdf.lasting import on_disk

_STARTS = 64
_MAX_ITERATIONS = 1000
_TOLERANCE = 1e-6
"""EM has converged when the mean log-likelihood of a basis BRDF rises by less than this."""

_COINCIDENT = 1e-7
"""Basis BRDFs whose coordinates differ by less than this, relative to the largest coordinate, count as the same."""

_RELATIVE_FLOOR = 1e-12
"""Added to each covariance, times the mean square of the coordinates: invertible without an absolute scale."""


def subspace_coordinates(gram: Tensor, n_dims: int) -> Tensor:
    """Coordinates of the basis BRDFs in their first singular vectors, U~^T B = (S V^T)~ [CBP21, eq. 18].

    gram     (n, n)  B^T B, float64: its eigenvectors are V, its eigenvalues S^2, so B itself is not needed
    returns  (n, n_dims)
    """
    squared, v = torch.linalg.eigh(gram)
    largest = torch.arange(len(gram) - 1, len(gram) - 1 - n_dims, -1)
    return v[:, largest] * squared[largest].clamp_min(0).sqrt()


def log_normal(x: Tensor, means: Tensor, covariances: Tensor) -> Tensor:
    """log N(x_i | mu_j, Sigma_j): x (n, N), means (K, N), covariances (K, N, N) -> (n, K)."""
    factor = torch.linalg.cholesky(covariances)
    centred = (x[None] - means[:, None]).transpose(1, 2)
    whitened = torch.linalg.solve_triangular(factor, centred, upper=False)
    log_det = 2 * torch.log(torch.diagonal(factor, dim1=1, dim2=2)).sum(1)
    return -0.5 * (whitened.square().sum(1) + log_det[:, None] + x.shape[1] * log(2 * pi)).T


def expectation(x: Tensor, mixing: Tensor, means: Tensor, covariances: Tensor) -> tuple[Tensor, Tensor]:
    """Responsibilities gamma_j(b_i) (n, K) and the log-likelihood of each point (n,) [CBP21, eqs. 13, 17]."""
    joint = torch.log(mixing) + log_normal(x, means, covariances)
    likelihood = torch.logsumexp(joint, dim=1)
    return torch.exp(joint - likelihood[:, None]), likelihood


def maximisation(x: Tensor, responsibilities: Tensor, floor: float) -> tuple[Tensor, Tensor, Tensor]:
    """Mixing coefficients (K,), means (K, N), covariances (K, N, N) [CBP21, eqs. 14-16].

    Eqs. 15 and 16 as printed divide by pi_j; a mean and a covariance divide by n pi_j, as here.
    """
    count = responsibilities.sum(0)
    share = responsibilities / count
    means = share.T @ x
    centred = x[None] - means[:, None]
    covariances = (share.T[:, :, None] * centred).transpose(1, 2) @ centred
    return count / len(x), means, covariances + floor * torch.eye(x.shape[1], dtype=x.dtype)


def k_means(x: Tensor, k: int, generator: torch.Generator) -> Tensor:
    """Labels (n,) of one run of k-means from a k-means++ start [AV07]; x (n, N) has at least k different points."""
    centres = x[torch.randint(len(x), (1,), generator=generator)]
    while len(centres) < k:
        nearest = _distances(x, centres).square().amin(1)
        centres = torch.cat([centres, x[torch.multinomial(nearest, 1, generator=generator)]])
    labels = torch.full((len(x),), -1)
    for _ in range(_MAX_ITERATIONS):
        nearest_centre = _distances(x, centres).argmin(1)
        if torch.equal(nearest_centre, labels):
            break
        labels = nearest_centre
        present = torch.bincount(labels, minlength=k) > 0
        centres = torch.stack([x[labels == j].mean(0) if present[j] else centres[j] for j in range(k)])
    return labels


def _distances(x: Tensor, centres: Tensor) -> Tensor:
    """(n, k), from differences: |x|^2 - 2 x c + |c|^2 would be rounding noise for points that nearly coincide."""
    return torch.cdist(x, centres, compute_mode="donot_use_mm_for_euclid_dist")


@dataclass(frozen=True)
class Mixture:
    """A mixture of K Gaussians in N dimensions, and how its fit went.

    mixing (K,), means (K, N), covariances (K, N, N); responsibilities (n, K) of the points it was fitted to;
    history: the mean log-likelihood of a point after every step of EM
    """

    mixing: Tensor
    means: Tensor
    covariances: Tensor
    responsibilities: Tensor
    history: tuple[float, ...]
    converged: bool

    @property
    def tensors(self) -> dict[str, Tensor]:
        """All of it as float64 tensors."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: torch.as_tensor(value, dtype=torch.float64) for name, value in values.items()}

    @classmethod
    def from_tensors(cls, tensors: dict[str, Tensor]) -> "Mixture":
        """The inverse of `tensors`."""
        return cls(
            mixing=tensors["mixing"],
            means=tensors["means"],
            covariances=tensors["covariances"],
            responsibilities=tensors["responsibilities"],
            history=tuple(tensors["history"].tolist()),
            converged=bool(tensors["converged"]),
        )


def expectation_maximisation(x: Tensor, labels: Tensor, k: int) -> Mixture:
    """EM from a partition of the points x (n, N) float64 [CBP21, eqs. 13-17]."""
    floor = _RELATIVE_FLOOR * float(x.square().mean())
    parameters = maximisation(x, torch.nn.functional.one_hot(labels, k).to(x.dtype), floor)
    history: list[float] = []
    while True:
        responsibilities, likelihood = expectation(x, *parameters)
        history.append(float(likelihood.mean()))
        converged = len(history) > 1 and history[-1] - history[-2] < _TOLERANCE
        if converged or len(history) == _MAX_ITERATIONS:
            return Mixture(*parameters, responsibilities, tuple(history), converged)
        parameters = maximisation(x, responsibilities, floor)


def count_different(x: Tensor) -> int:
    """How many of the points (n, N) differ by more than the rounding of coordinates that come from a Gram matrix."""
    return len(torch.unique(torch.round(x / (_COINCIDENT * x.abs().amax())), dim=0))


def fit_mixture(x: Tensor, k: int, seed: int, smallest: int) -> Mixture | None:
    """The most likely of the mixtures that EM reaches from several k-means starts.

    Classes are ordered by the norm of their means: diffuse materials first, metals last.

    The likelihood of a mixture is unbounded: a Gaussian may collapse on a few points. So a class must hold at least
    `smallest` points (N + 1 span a covariance); None where no start leads to such classes.
    """
    if k > 1 and count_different(x) < k * smallest:
        return None
    generator = torch.Generator().manual_seed(seed)
    best = None
    for _ in range(_STARTS if k > 1 else 1):
        labels = k_means(x, k, generator)
        if k > 1 and torch.bincount(labels, minlength=k).amin() < 1:
            continue
        mixture = expectation_maximisation(x, labels, k)
        sizes = torch.bincount(mixture.responsibilities.argmax(1), minlength=k)
        if k > 1 and sizes.amin() < smallest:
            continue
        if best is None or mixture.history[-1] > best.history[-1]:
            best = mixture
    return None if best is None else _dullest_first(best)


def _dullest_first(mixture: Mixture) -> Mixture:
    order = torch.argsort(torch.linalg.vector_norm(mixture.means, dim=1), stable=True)
    return replace(
        mixture,
        mixing=mixture.mixing[order],
        means=mixture.means[order],
        covariances=mixture.covariances[order],
        responsibilities=mixture.responsibilities[:, order],
    )


def _fitted(library: MaterialLibrary, x: Tensor, n_classes: int, seed: int, smallest: int) -> tuple[int, Mixture]:
    """The largest number of classes that the library supports, and their mixture; on disk, as the library itself is."""

    def fit() -> Mixture:
        fits = (fit_mixture(x, k, seed, smallest) for k in range(n_classes, 0, -1))
        return next(mixture for mixture in fits if mixture is not None)

    if library.stored.mapping is None:
        mixture = fit()
    else:
        settings = [_STARTS, _MAX_ITERATIONS, _TOLERANCE, _COINCIDENT, _RELATIVE_FLOOR]
        depends = [library.source, library.names, n_classes, seed, smallest, *settings]
        mixture = Mixture.from_tensors(on_disk("classes", depends, lambda: fit().tensors))
    return len(mixture.mixing), mixture


class MaterialClasses(SharedBuffers):
    """Which of K material classes each basis BRDF belongs to [CBP21, sec. IV].

    mixing (K,), means (K, N), covariances (K, N, N)  the mixture, in the coordinates U~^T B
    responsibilities  (n, K)  gamma_j(b_i), eq. 13
    labels            (n,)    the class of largest responsibility
    norms             (n,)    |b_i|, of every basis BRDF

    `MaterialClasses.fit` makes them; `single` puts all basis BRDFs into one class.
    """

    mixing: Tensor
    means: Tensor
    covariances: Tensor
    responsibilities: Tensor
    labels: Tensor
    norms: Tensor

    def __init__(self, mixture: Mixture, names: Sequence[str], library: str, norms: Tensor | None = None) -> None:
        """Keep a mixture whose points are the columns of the library with this fingerprint; norms None: all alike."""
        super().__init__()
        self.names = tuple(names)
        self.library = library
        self.history = mixture.history
        self.converged = mixture.converged
        for buffer in ("mixing", "means", "covariances", "responsibilities"):
            self.register_buffer(buffer, getattr(mixture, buffer))
        self.register_buffer("labels", mixture.responsibilities.argmax(1))
        self.register_buffer("norms", torch.ones_like(mixture.responsibilities[:, 0]) if norms is None else norms)

    @classmethod
    def fit(
        cls, library: MaterialLibrary, n_classes: int = N_CLASSES, n_dims: int = N_DIMS, seed: int = 0
    ) -> "MaterialClasses":
        """The mixture of n_classes Gaussians in the first n_dims singular vectors of B.

        Where the library cannot support so many classes (each needs n_dims + 1 different members), there are fewer,
        with a warning. Raises ValueError for anything but a library, and for one of which every basis BRDF is zero.
        """
        check_types("MaterialClasses.fit", library=(library, MaterialLibrary))
        if n_classes < 1 or n_dims < 1:
            raise ValueError(f"n_classes and n_dims must be at least 1, got {n_classes} and {n_dims}")
        x = subspace_coordinates(library.gram, min(n_dims, library.n))
        if not x.abs().amax() > 0:
            raise ValueError(f"{library!r}: every basis BRDF is zero; there is nothing to classify")
        smallest = n_dims + 1
        k, mixture = _fitted(library, x, n_classes, seed, smallest)
        if k < n_classes:
            warnings.warn(
                f"{library!r} supports {k} material class{'es' if k > 1 else ''}, not {n_classes}: no partition of its "
                f"{count_different(x)} different basis BRDFs gives each at least {smallest}; "
                "add materials or ask for fewer classes",
                UserWarning,
                stacklevel=2,
            )
        return cls(mixture, library.names, library.source, library.gram.diagonal().clamp_min(0).sqrt())

    @classmethod
    def single(cls, library: MaterialLibrary) -> "MaterialClasses":
        """All basis BRDFs in one class: the paper's single-class comparison (its Fig. 5)."""
        return cls.fit(library, n_classes=1)

    def __copy__(self) -> "MaterialClasses":
        """Another module of the same tensors: moved, cast or loaded, either leaves the other as it is."""
        twin = MaterialClasses.__new__(MaterialClasses)
        twin.__dict__.update(self.__dict__, _buffers=dict(self._buffers))
        return twin

    @property
    def n_classes(self) -> int:
        """K."""
        return self.responsibilities.shape[1]

    @property
    def sizes(self) -> list[int]:
        """c_j: the number of basis BRDFs of every class."""
        return torch.bincount(self.labels, minlength=self.n_classes).tolist()

    @property
    def membership(self) -> Tensor:
        """(K, n) bool: the basis BRDFs of every class."""
        return self.labels == torch.arange(self.n_classes, device=self.labels.device)[:, None]

    def members(self, j: int) -> Tensor:
        """(c_j,) int64: the basis BRDFs of class j."""
        return torch.nonzero(self.labels == j).ravel()

    def extra_repr(self) -> str:
        """Sizes, for `repr`."""
        sizes = "" if self.labels.is_meta else f" in classes of {self.sizes}"
        return f"{len(self.labels)} basis BRDFs{sizes}"

    def table(self) -> str:
        """Which material is in which class, a line each; the channels are named where they differ."""
        lines = []
        for j in range(self.n_classes):
            lines.append(f"class {j}: {self.sizes[j]} basis BRDFs")
            for i, name in enumerate(self.names):
                inside = [channel for c, channel in enumerate("RGB") if int(self.labels[3 * i + c]) == j]
                if inside:
                    lines.append(f"  {name}" + (f" ({''.join(inside)})" if len(inside) < 3 else ""))
        return "\n".join(lines)
