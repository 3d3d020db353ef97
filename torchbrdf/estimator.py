"""From a photograph to weights: one solve per class, the best class wins [CBP21, sec. VI]."""

import warnings
from collections.abc import Mapping
from typing import Any, Literal

import torch
from torch import Tensor, nn

from torchbrdf.basis_images import BasisImages
from torchbrdf.classes import MaterialClasses
from torchbrdf.packing import pack, unpack
from torchbrdf.reconstruction import Reconstruction
from torchbrdf.solvers import GramFactor, balance, prior_mean, ridge, ridge_lstsq

PAPER_PENALTY = 0.5
"""lambda of [CBP21, eq. 25]."""

DEFAULT_PENALTY: Literal["paper"] | float = 0.0005
"""lambda of the estimator and the command line: the best fixed one for the four classes in docs/leave_one_out.md."""

Solver = Literal["factored", "lstsq"]


class BRDFEstimator(nn.Module):
    """The BRDF of a photographed shape as a combination of basis BRDFs.

    basis    Y, the basis images under the light and from the view of the photograph
    classes  the material classes of the same library
    penalty  "paper" for lambda = 0.5, or lambda >= 0 itself [CBP21, eq. 25]
    solver   "factored": singular values and vectors of every class's basis images, computed at the first
             photograph and used for all; "lstsq": `torch.linalg.lstsq` on the augmented system, every time

    For each class and colour channel it minimises |Y w - y|^2 + lambda_j |w - mu'_j|^2 (eq. 26 with Sigma' =
    identity) and keeps the class with the smallest |Y w - y|^2 summed over the channels (eq. 19). Gradients flow
    to the photograph. The arithmetic is float64. Warns where the shape shows too few normals (a plane, a cube).
    """

    packed: Tensor
    mask: Tensor

    def __init__(
        self,
        basis: BasisImages,
        classes: MaterialClasses,
        penalty: Literal["paper"] | float = DEFAULT_PENALTY,
        solver: Solver = "factored",
    ) -> None:
        """Check that basis and classes belong together."""
        super().__init__()
        if (basis.library, basis.names) != (classes.library, classes.names):
            raise ValueError("basis images and classes come from different libraries; make both from the same one")
        if penalty != "paper" and not (isinstance(penalty, int | float) and 0 <= penalty < float("inf")):
            raise ValueError(f'penalty must be "paper" or a number >= 0, got {penalty!r}')
        if solver not in ("factored", "lstsq"):
            raise ValueError(f'solver must be "factored" or "lstsq", got {solver!r}')
        if basis.distrust is not None:
            warnings.warn(basis.distrust, UserWarning, stacklevel=2)
        self.penalty = penalty
        self.solver = solver
        self.names, self.library, self.probe, self.view = basis.names, basis.library, basis.probe, basis.view
        self.classes = classes
        self.register_buffer("packed", basis.packed)
        self.register_buffer("mask", basis.mask)
        self._factors: list[GramFactor] | None = None
        self.register_load_state_dict_pre_hook(_check_state)
        self.register_load_state_dict_post_hook(_forget_factors)

    def get_extra_state(self) -> dict[str, str]:
        """The fingerprints of what a state_dict was made from."""
        return {"library": self.library, "names": " ".join(self.names), "probe": self.probe, "view": self.view}

    def set_extra_state(self, state: Mapping[str, str]) -> None:
        """Take over the probe and view of a state_dict; one for other materials was refused before."""
        self.probe, self.view = state["probe"], state["view"]

    def extra_repr(self) -> str:
        """Settings and sizes, for `repr`."""
        n, _, p = self.packed.shape
        return f"penalty={self.penalty!r}, solver={self.solver!r}, n={n}, pixels={p}"

    def forward(self, image: Tensor, mask: Tensor | None = None) -> Reconstruction:
        """Reconstruct the material of photographs.

        image    (*batch, 3, H, W)  linear radiance, float32 or float64, the size of the basis images
        mask     (*batch, 1, H, W) or (1, H, W)  bool, True = use; None for all pixels of the basis images
        returns  a Reconstruction with the same batch axes; weights and image in the precision of `image`
        Raises ValueError where sizes differ, a used pixel is not finite, all are zero, or none is left.
        """
        y, used, batch = self._observation(image, mask)
        weights = y.new_zeros(len(y), self.classes.n_classes, self.packed.shape[0], 3)
        masks, group = torch.unique(used, dim=0, return_inverse=True)
        for k in range(len(masks)):
            photographs = torch.nonzero(group == k).ravel()
            weights = weights.index_copy(0, photographs, self._solve(y[photographs], masks[k]))
        fitted = torch.einsum("bkns,nsp->bksp", weights, self.packed.double())
        residual = torch.where(used[:, None, None], fitted - y[:, None], 0)
        errors = residual.square().sum((-2, -1))
        best = errors.argmin(1)
        chosen = fitted[torch.arange(len(y), device=y.device), best]

        def shaped(values: Tensor) -> Tensor:
            values = values.to(image.dtype) if values.is_floating_point() else values
            return values.reshape((*batch, *values.shape[1:]))

        return Reconstruction(
            class_weights=shaped(weights),
            class_errors=shaped(errors),
            class_index=shaped(best),
            energy=shaped(torch.where(used[:, None], y, 0).square().sum((-2, -1))),
            image=shaped(unpack(chosen, self.mask)),
            names=self.names,
            library=self.library,
        )

    def _observation(self, image: Tensor, mask: Tensor | None) -> tuple[Tensor, Tensor, torch.Size]:
        """y (B, 3, P) float64, which of its pixels to use (B, P) bool, and the batch axes; checks them."""
        size = self.mask.shape[-2:]
        if image.ndim < 3 or image.shape[-3] != 3 or image.shape[-2:] != size:
            raise ValueError(
                f"image must be (*batch, 3, {size[0]}, {size[1]}) like the basis images, got {tuple(image.shape)}"
            )
        if image.dtype not in (torch.float32, torch.float64):
            raise ValueError(f"image must be float32 or float64 linear radiance, got {image.dtype}")
        batch = image.shape[:-3]
        y = pack(image.reshape(-1, 3, *size), self.mask).double()
        if mask is None:
            used = torch.ones_like(y[:, 0], dtype=torch.bool)
        elif mask.dtype == torch.bool and mask.shape in ((1, *size), (*batch, 1, *size)):
            used = pack(mask.reshape(-1, *size).to(image.device), self.mask).expand(len(y), -1)
        else:
            raise ValueError(
                f"mask must be bool {(1, *size)} or {(*batch, 1, *size)}, got {mask.dtype} {tuple(mask.shape)}"
            )
        unsound = int((~torch.isfinite(y).all(1) & used).sum())
        if unsound:
            raise ValueError(f"image holds {unsound} NaN or infinite pixels under the mask; mask them out")
        empty = torch.nonzero(~used.any(1)).ravel().tolist()
        if empty:
            raise ValueError(f"mask leaves no pixel of the view to use in photograph {empty[0]} of {len(y)}")
        y = torch.where(used[:, None], y, 0)
        black = torch.nonzero(~(y.detach() != 0).any(-1).any(-1)).ravel().tolist()
        if black:
            raise ValueError(f"photograph {black[0]} of {len(y)} is black: every pixel under the mask is 0")
        return y, used, batch

    def _solve(self, y: Tensor, used: Tensor) -> Tensor:
        """Weights (B, K, n, 3) of photographs y (B, 3, P) that share the pixels used (P,)."""
        whole = bool(used.all())
        basis = self.packed if whole else self.packed[..., used]
        y = y[..., used]
        energy = y.square().sum(-1)
        factors = self._class_factors(basis, cached=whole) if self.solver == "factored" else None
        weights = y.new_zeros(len(y), self.classes.n_classes, self.packed.shape[0], 3)
        penalty = PAPER_PENALTY if self.penalty == "paper" else float(self.penalty)
        for j in range(self.classes.n_classes):
            members = self.classes.members(j)
            prior = prior_mean(len(members), like=y)
            strength = balance(penalty, energy, len(members))
            if factors is None:
                solution = ridge_lstsq(basis[members], y, prior, strength)
            else:
                projection = torch.einsum("nsp,bsp->bsn", basis[members].double(), y)
                solution = ridge(factors[j], projection, prior, strength)
            weights[:, j, members] = solution.mT
        return weights

    def _class_factors(self, basis: Tensor, cached: bool) -> list[GramFactor]:
        """The factors of all classes; those of the unmasked basis are made once a device."""
        if not cached:
            return [GramFactor.of(basis[self.classes.members(j)]) for j in range(self.classes.n_classes)]
        if self._factors is None or self._factors[0].values.device != basis.device:
            self._factors = self._class_factors(basis, cached=False)
        return self._factors


def _check_state(module: BRDFEstimator, state: Mapping[str, Any], prefix: str, *_: object) -> None:
    """Refuse a state_dict for other materials before any of it is copied."""
    origin = state.get(f"{prefix}_extra_state")
    if origin is not None and (origin["library"], origin["names"]) != (module.library, " ".join(module.names)):
        raise ValueError("this state_dict belongs to an estimator with another material library")


def _forget_factors(module: BRDFEstimator, _: object) -> None:
    """The factors of the basis images that a state_dict has just replaced are stale."""
    module._factors = None
