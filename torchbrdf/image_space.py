"""The space that weighted basis images span: every photograph is seen through its coordinates there.

Residuals are divided by m + 0.3 mean(m), with m the mean basis image: dark pixels count by their relative error, as
photographs and renderings are wrong by a share of the radiance, and black ones do not count without bound.
Weights that come from the basis instead of the photograph leave the factorisation to be made once a probe.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

DARKEST = 0.3
"""What is added to the mean basis image, in units of its mean over the pixels."""

CUT = 5e-5
"""Directions below this, relative to the largest singular value, are dropped: basis images are not that accurate."""

_ROUNDING = 1e-12
"""A direction of less than this share of the energy of all is rounding of the Gram matrix."""

_BRIEF = 0.5
"""Up to this share of pixels left out, the Gram matrix loses them; above it is formed anew from those left."""


@dataclass(frozen=True, eq=False)
class ImageSpace:
    """diag(1/scale) Y = U R, one factorisation a colour channel of the light, cut at CUT.

    scale   (3, P) float64     what residuals are divided by, 0 in a channel without light
    u       (3, P, r) float32  orthonormal columns; float32 rounds a photograph by 1e-7 of itself, and no more, for
                               coordinates in an orthonormal basis cannot amplify it
    r       (3, r, n) float64  the basis images in these coordinates
    """

    scale: Tensor
    u: Tensor
    r: Tensor

    @classmethod
    def of(cls, packed: Tensor, sizes: Sequence[int]) -> "ImageSpace":
        """Factor basis images.

        packed  (n, 3, P)  of one photograph, or of several one behind the other
        sizes   pixels of each photograph: each has its own mean over the pixels
        """
        y = packed.detach().double()
        mean = y.mean(0)
        levels = [part.mean(-1, keepdim=True).expand_as(part) for part in mean.split(list(sizes), dim=-1)]
        scale = mean.abs() + DARKEST * torch.cat(levels, -1).abs()
        weighted = (y * _inverse(scale)).permute(1, 2, 0)
        squared, v = torch.linalg.eigh(weighted.mT @ weighted)
        squared, v = squared.flip(-1), v.flip(-1)
        rank = int((squared > CUT**2 * squared[:, :1]).sum(-1).max().clamp_min(1))
        squared, v = squared[:, :rank], v[..., :rank]
        singular = torch.where(squared > _ROUNDING * squared[:, :1], squared, 0).clamp_min(0).sqrt()
        u = weighted @ (v * _inverse(singular)[:, None])
        return cls(scale, u.float(), singular[..., None] * v.mT)

    @property
    def energy(self) -> Tensor:
        """(3, n): |y_i|^2 of every weighted basis image."""
        return self.r.square().sum(1)

    def masked(self, used: Tensor) -> "ImageSpace":
        """The space of some pixels (P,) bool only, from this one.

        U^T U of the pixels left is I less that of the pixels left out: whichever are fewer are summed.
        """
        eye = torch.eye(self.u.shape[-1], dtype=torch.float64, device=self.u.device)
        kept = self.u[:, used].double()
        if float((~used).double().mean()) < _BRIEF:
            lost = self.u[:, ~used].double()
            gram = eye - lost.mT @ lost
        else:
            gram = kept.mT @ kept
        squared, v = torch.linalg.eigh(gram)
        squared, v = squared.flip(-1), v.flip(-1)
        sound = squared > _ROUNDING ** (2 / 3) * squared[:, :1].clamp_min(torch.finfo(squared.dtype).tiny)
        rank = int(sound.sum(-1).max().clamp_min(1))
        singular, v = torch.where(sound, squared, 0)[:, :rank].clamp_min(0).sqrt(), v[..., :rank]
        u = kept @ (v * _inverse(singular)[:, None])
        return ImageSpace(self.scale[:, used], u.float(), singular[..., None] * v.mT @ self.r)

    def project(self, y: Tensor) -> tuple[Tensor, Tensor]:
        """Photographs (B, 3, P) -> coordinates (B, 3, r) float64, and energy (B, 3) of the weighted photographs.

        The product with U is made in the photographs' own precision.
        """
        weighted = y * _inverse(self.scale).to(y.dtype)
        coordinates = torch.einsum("bsp,spr->bsr", weighted, self.u.to(y.dtype)).double()
        return coordinates, weighted.double().square().sum(-1)

    def render(self, weights: Tensor, dtype: torch.dtype) -> Tensor:
        """Y w, less what was cut: weights (*batch, 3, n) -> (*batch, 3, P)."""
        coordinates = torch.einsum("srn,...sn->...sr", self.r, weights).to(dtype)
        return torch.einsum("spr,...sr->...sp", self.u.to(dtype), coordinates) * self.scale.to(dtype)


def _inverse(x: Tensor) -> Tensor:
    """1 / x, and 0 where x is 0."""
    zero = x == 0
    return torch.where(zero, 0, 1 / torch.where(zero, 1, x))
