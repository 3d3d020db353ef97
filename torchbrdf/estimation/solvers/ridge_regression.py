"""The regularised least squares of one class, and its cached factorisation [CBP21, eqs. 25-26].

All of it works in float64: a Gram matrix squares the condition number, and float32 loses the weights at small
penalties. Shapes: c basis BRDFs, P pixels, three colour channels, each solved for itself.
"""

from dataclasses import dataclass

import torch
from torch import Tensor


def prior_mean(c: int, like: Tensor) -> Tensor:
    """mu'_j (c,): the mean BRDF of the class [CBP21, eq. 24]."""
    return torch.full((c,), 1.0 / c, dtype=like.dtype, device=like.device)


def balance(penalty: float, energy: Tensor, c: int) -> Tensor:
    """lambda_j = lambda |y|^2 / c_j [CBP21, eq. 25]; energy is |y|^2 of each channel (*batch, 3)."""
    return penalty * energy / c


@dataclass(frozen=True)
class GramFactor:
    """Eigenvectors and eigenvalues of Y^T Y, per channel: with them every penalty is a rescaling.

    values   (3, c)     descending, the squares of the singular values of Y
    vectors  (3, c, c)  columns are eigenvectors
    """

    values: Tensor
    vectors: Tensor

    @classmethod
    def of(cls, basis: Tensor) -> "GramFactor":
        """Factor the basis images (c, 3, P) of one class; no gradient flows to them.

        By singular values of the triangle of Y = Q R: forming Y^T Y would square its condition number, and lose
        those below 1e-8 of the largest.
        """
        y = basis.detach().double().permute(1, 2, 0)
        _, singular, v = torch.linalg.svd(torch.linalg.qr(y, mode="r").R)
        values = singular.new_zeros(v.shape[:-1])
        values[..., : singular.shape[-1]] = singular.square()
        return cls(values, v.mT)

    def precision(self, strength: Tensor) -> Tensor:
        """Y^T Y + strength I (*batch, 3, c, c): strength (*batch, 3)."""
        return (self.vectors * (self.values + strength[..., None])[..., None, :]) @ self.vectors.mT


def ridge(factor: GramFactor, projection: Tensor, prior: Tensor, strength: Tensor) -> Tensor:
    """Weights that minimise |Y w - y|^2 + strength |w - prior|^2 [CBP21, eq. 26, with Sigma' = identity].

    projection  (*batch, 3, c)  Y^T y
    prior       (c,)            mu'
    strength    (*batch, 3)     lambda_j; where it is 0 the solution of smallest norm
    returns     (*batch, 3, c)
    """
    v = factor.vectors
    rotated = (v.mT @ (projection + strength[..., None] * prior)[..., None])[..., 0]
    spectrum = factor.values + strength[..., None]
    cutoff = (torch.finfo(v.dtype).eps * v.shape[-1]) ** 2 * factor.values[..., :1]
    kept = spectrum > cutoff
    filtered = torch.where(kept, rotated / torch.where(kept, spectrum, 1.0), 0.0)
    return (v @ filtered[..., None])[..., 0]


def ridge_lstsq(basis: Tensor, image: Tensor, prior: Tensor, strength: Tensor) -> Tensor:
    """The same weights by `torch.linalg.lstsq` on the augmented system: the reference path.

    basis    (c, 3, P)
    image    (*batch, 3, P)
    returns  (*batch, 3, c)
    """
    c = basis.shape[0]
    y = basis.double().permute(1, 2, 0).expand(*image.shape[:-2], -1, -1, -1)
    damped = strength > 0  # the square root has no derivative at 0
    root = torch.where(damped, torch.sqrt(torch.where(damped, strength, 1.0)), 0.0)[..., None]
    damping = root[..., None] * torch.eye(c, dtype=y.dtype, device=y.device)
    system = torch.cat([y, damping], dim=-2)
    target = torch.cat([image, root * prior], dim=-1)
    driver = "gels" if system.is_cuda else "gelsd"
    return torch.linalg.lstsq(system, target[..., None], driver=driver).solution[..., 0]
