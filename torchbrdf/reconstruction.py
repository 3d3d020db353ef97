"""What the estimator found: weights, the class that won, and every class's candidate."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchbrdf.library import MaterialLibrary
from torchbrdf.merl import MerlTable


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Reconstructions of a batch of photographs; every tensor starts with the batch axes.

    class_weights  (*batch, K, n, 3)  the candidate of every class, 0 for basis BRDFs of other classes
    class_errors   (*batch, K)        |Y w - y|^2 of every candidate over the pixels used [CBP21, eq. 19]
    class_index    (*batch)           int64, the class that was chosen
    energy         (*batch)           |y|^2 over the pixels used
    image          (*batch, 3, H, W)  Y w: the photograph as the chosen candidate explains it
    names          the materials behind the n = 3 len(names) weights
    library        fingerprint of their columns
    """

    class_weights: Tensor
    class_errors: Tensor
    class_index: Tensor
    energy: Tensor
    image: Tensor
    names: tuple[str, ...]
    library: str

    @property
    def weights(self) -> Tensor:
        """(*batch, n, 3): rho = B w, one column a colour channel [CBP21, eq. 1]."""
        shape = (*self.class_index.shape, 1, *self.class_weights.shape[-2:])
        index = self.class_index[..., None, None, None].expand(shape)
        return self.class_weights.gather(-3, index).squeeze(-3)

    @property
    def relative_error(self) -> Tensor:
        """(*batch): |Y w - y| / |y| of the chosen candidate. Small does not mean right: see `class_errors`."""
        chosen = self.class_errors.gather(-1, self.class_index[..., None])[..., 0]
        return torch.sqrt(chosen / self.energy)

    def __len__(self) -> int:
        """The size of the first batch axis."""
        if self.class_index.ndim == 0:
            raise TypeError("a single reconstruction has no length")
        return len(self.class_index)

    def __getitem__(self, i: int) -> "Reconstruction":
        """One reconstruction of a batch."""
        if self.class_index.ndim == 0:
            raise IndexError("this is a single reconstruction; it has no batch axis to index")
        tensors = ("class_weights", "class_errors", "class_index", "energy", "image")
        return replace(self, **{name: getattr(self, name)[i] for name in tensors})

    def candidate(self, j: int, library: MaterialLibrary) -> MerlTable:
        """The BRDF that class j would give; see `brdf`."""
        self._check(library)
        return library.combine(self.class_weights[j], f"class {j}")

    def brdf(self, library: MaterialLibrary) -> MerlTable:
        """The full table rho = B w, cells below zero set to zero.

        Raises ValueError for a batch (pick one with result[i]) or another library than that of the basis images.
        """
        return self.candidate(int(self._check(library).class_index), library)

    def _check(self, library: MaterialLibrary) -> "Reconstruction":
        if self.class_index.ndim:
            raise ValueError(
                f"brdf needs a single reconstruction, this holds a batch {tuple(self.class_index.shape)}; "
                "pick one: result[i]"
            )
        if (library.source, library.names) != (self.library, self.names):
            raise ValueError("this library is not the one that the basis images were rendered with")
        return self
