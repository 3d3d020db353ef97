"""The space that weighted basis images span: every photograph is seen through its coordinates there.

Residuals are divided by m + 0.3 mean(m), with m the mean basis image: dark pixels count by their relative error, as
photographs and renderings are wrong by a share of the radiance, and black ones do not count without bound.
Weights that come from the basis instead of the photograph leave the factorisation to be made once a probe.

Errors that pixels share (`smooth_errors`) are columns beside the basis images: the space spans both, and in its
coordinates, where they take a small product, residuals are made white again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from torchbrdf.brdf import lower_gram
from torchbrdf.estimation.eigenpairs import eigh
from torchbrdf.lasting import lasting

DARKEST = 0.3
"""What is added to the mean basis image, in units of its mean over the pixels."""

CUT = 5e-5
"""Directions below this, relative to the largest singular value, are dropped: basis images are not that accurate."""

_ROUNDING = 1e-12
"""A direction of less than this share of the energy of all is rounding of the Gram matrix."""

_BRIEF = 0.5
"""Up to this share of pixels left out, the Gram matrix loses them; above it is formed anew from those left."""


def residual_scale(image: Tensor, sizes: Sequence[int]) -> Tensor:
    """image + 0.3 mean(image) (3, P), the mean over the pixels of each photograph, whose number `sizes` tells."""
    levels = [part.mean(-1, keepdim=True).expand_as(part) for part in image.split(list(sizes), dim=-1)]
    return image.abs() + DARKEST * torch.cat(levels, -1).abs()


@dataclass(frozen=True, eq=False)
class ImageSpace:
    """diag(1/scale) Y = U R, one factorisation a colour channel of the light, cut at CUT.

    scale   (3, P) float64     what residuals are divided by, 0 in a channel without light
    u       (3, P, r) float64  orthonormal columns. In float32 what a photograph holds outside their span, a
                               difference of squares, would be rounding where a fit is good, and the evidence with it
    r       (3, r, n) float64  the basis images in these coordinates
    photographs  how many lie one behind the other
    errors  (3, r, k) float64  errors that pixels share, in these coordinates; None for white noise only
    """

    scale: Tensor
    u: Tensor
    r: Tensor
    photographs: int = 1
    errors: Tensor | None = None

    @classmethod
    def of(cls, packed: Tensor, sizes: Sequence[int], errors: Tensor | None = None) -> "ImageSpace":
        """Factor basis images.

        packed  (n, 3, P)  of one photograph, or of several one behind the other
        sizes   pixels of each photograph: each has its own mean over the pixels
        errors  (P, k)  that pixels share, see `smooth_errors`
        """
        mean = packed.detach().mean(0, dtype=torch.float64)
        return replace(cls.weighted(packed, residual_scale(mean, sizes), errors), photographs=len(sizes))

    @classmethod
    def weighted(cls, packed: Tensor, scale: Tensor, errors: Tensor | None = None) -> "ImageSpace":
        """Factor basis images (n, 3, P) divided by any scale (3, P), and errors (P, k)."""
        weighted, n = _weighted(packed, scale, errors), len(packed)
        singular, v = _principal(lower_gram(weighted))
        u = _orthonormal((v * _inverse(singular)[:, None]).mT @ weighted).mT
        r = singular[..., None] * v.mT
        return cls(scale, u, r[..., :n], errors=None if errors is None else r[..., n:])

    @cached_property
    @lasting
    def white(self) -> Tensor:
        """(3, r, n): `r`, with the covariance of errors made I."""
        return self.whitened(self.r)

    def whitened(self, columns: Tensor) -> Tensor:
        """Columns (3, r, m) of coordinates, with the covariance of errors made I: L^-1 of I + E E^T = L L^T."""
        root = self._root
        return columns if root is None else torch.linalg.solve_triangular(root, columns, upper=False)

    @cached_property
    @lasting
    def _root(self) -> Tensor | None:
        if self.errors is None:
            return None
        eye = torch.eye(self.errors.shape[1], dtype=torch.float64, device=self.errors.device)
        return torch.linalg.cholesky(eye + self.errors @ self.errors.mT)

    @cached_property
    @lasting
    def single(self) -> Tensor:
        """U in float32, to render with: there nothing amplifies its rounding."""
        return self.u.float()

    @property
    def energy(self) -> Tensor:
        """(3, n): |y_i|^2 of every weighted and whitened basis image."""
        return self.white.square().sum(1)

    def masked(self, used: Tensor) -> "ImageSpace":
        """The space of some pixels (P,) bool only, from this one.

        U^T U of the pixels left is I less that of the pixels left out: whichever are fewer are summed.
        """
        eye = torch.eye(self.u.shape[-1], dtype=torch.float64, device=self.u.device)
        kept = self.u[:, used]
        if float((~used).double().mean()) < _BRIEF:
            lost = self.u[:, ~used]
            gram = eye - lost.mT @ lost
        else:
            gram = kept.mT @ kept
        squared, v = eigh(gram)
        squared, v = squared.flip(-1), v.flip(-1)
        sound = squared > _ROUNDING ** (2 / 3) * squared[:, :1].clamp_min(torch.finfo(squared.dtype).tiny)
        rank = int(sound.sum(-1).max().clamp_min(1))
        singular, v = torch.where(sound, squared, 0)[:, :rank].clamp_min(0).sqrt(), v[..., :rank]
        u = kept @ (v * _inverse(singular)[:, None])
        turned = singular[..., None] * v.mT
        errors = None if self.errors is None else turned @ self.errors
        return ImageSpace(self.scale[:, used], u, turned @ self.r, self.photographs, errors)

    @cached_property
    @lasting
    def inverse(self) -> Tensor:
        """(3, P): 1 / scale, 0 in a channel without light."""
        return _inverse(self.scale)

    @cached_property
    @lasting
    def overlap(self) -> Tensor:
        """(3, r, r): U^T diag(scale^2) U, what squares of differences between images are in these coordinates."""
        columns = self.u * self.scale[..., None]
        return columns.mT @ columns

    def project(self, y: Tensor) -> tuple[Tensor, Tensor]:
        """Photographs (B, 3, P) -> coordinates (B, 3, r) float64, and energy (B, 3) of the weighted photographs.

        float64, whatever the photographs' precision.
        """
        weighted = y * self.inverse
        return self._towards(weighted), weighted.square().sum(-1)

    def render(self, weights: Tensor, dtype: torch.dtype) -> Tensor:
        """Y w, less what was cut: weights (B, 3, n) -> (B, 3, P)."""
        coordinates = (weights.transpose(0, 1) @ self.r.mT).to(dtype)
        return (coordinates @ self._in(dtype).mT).transpose(0, 1) * self.scale.to(dtype)

    def growth(self, residual: Tensor, change: Tensor) -> Tensor:
        """(B, K): |residual + Y change|^2 - |residual|^2, for residuals (B, 3, P) and changes of weights (B, K, 3, n).

        From the coordinates alone: no image is made for it.
        """
        moved = (change.permute(2, 0, 1, 3).flatten(1, 2) @ self.r.mT).unflatten(1, change.shape[:2])  # (3, B, K, r)
        slope = self._towards(residual * self.scale.to(residual.dtype)).transpose(0, 1)[:, :, None]
        turned = (moved.flatten(1, 2) @ self.overlap).view_as(moved)
        return ((turned + 2 * slope) * moved).sum((0, -1))

    def _towards(self, image: Tensor) -> Tensor:
        """U^T times images (B, 3, P): (B, 3, r) float64."""
        return (image.transpose(0, 1) @ self._in(image.dtype)).transpose(0, 1).double()

    def _in(self, dtype: torch.dtype) -> Tensor:
        return self.single if dtype == torch.float32 else self.u


class UnformedSpace(ImageSpace):
    """An `ImageSpace` whose U is formed where it is asked for: one photograph is seen through Y itself.

    columns  (3, n + k, P) float64: weighted basis images, and errors
    inward   (3, n + k, r) float64: U = columns^T inward, but for rounding
    """

    columns: Tensor
    inward: Tensor

    def __init__(self, scale: Tensor, columns: Tensor, inward: Tensor, r: Tensor, errors: Tensor | None) -> None:
        """Of one photograph."""
        held = {"scale": scale, "r": r, "columns": columns, "inward": inward, "photographs": 1, "errors": errors}
        for name, value in held.items():
            object.__setattr__(self, name, value)

    @classmethod
    def weighted(cls, packed: Tensor, scale: Tensor, errors: Tensor | None = None) -> "UnformedSpace":
        """Basis images (n, 3, P) divided by any scale (3, P), and errors (P, k)."""
        columns, n = _weighted(packed, scale, errors), len(packed)
        singular, v = _principal(lower_gram(columns))
        r = singular[..., None] * v.mT
        return cls(scale, columns, v * _inverse(singular)[:, None], r[..., :n], None if errors is None else r[..., n:])

    @cached_property
    def u(self) -> Tensor:
        """Orthonormal columns (3, P, r)."""
        return _orthonormal(self.inward.mT @ self.columns).mT

    def first(self, count: int) -> "UnformedSpace":
        """The directions in which basis images are largest only."""
        errors = None if self.errors is None else self.errors[:, :count]
        return UnformedSpace(self.scale, self.columns, self.inward[..., :count], self.r[:, :count], errors)

    def render(self, weights: Tensor, dtype: torch.dtype) -> Tensor:
        """Y w, less what was cut: weights (B, 3, n) -> (B, 3, P)."""
        kept = weights.transpose(0, 1) @ self.r.mT @ self.inward.mT
        return (kept @ self.columns).transpose(0, 1).to(dtype) * self.scale.to(dtype)

    def _towards(self, image: Tensor) -> Tensor:
        return (image.double().transpose(0, 1) @ self.columns.mT @ self.inward).transpose(0, 1)


def _principal(gram: Tensor) -> tuple[Tensor, Tensor]:
    """Singular values (3, r) above CUT and their vectors (3, n, r), of the lower triangles of Y^T Y (3, n, n)."""
    squared, v = eigh(gram)
    squared, v = squared.flip(-1), v.flip(-1)
    rank = int((squared > CUT**2 * squared[:, :1]).sum(-1).max().clamp_min(1))
    energy = gram.diagonal(dim1=-2, dim2=-1)
    black = energy <= _ROUNDING**2 * energy.amax(-1, keepdim=True)
    squared, v = squared[:, :rank], torch.where(black[..., None], 0, v[..., :rank])
    return torch.where(squared > _ROUNDING * squared[:, :1], squared, 0).clamp_min(0).sqrt(), v


def _weighted(packed: Tensor, scale: Tensor, errors: Tensor | None) -> Tensor:
    """(3, n + k, P) float64, and errors (P, k): mixed precisions in one product are ten times slower."""
    n, channels, pixels = packed.shape
    weighted = scale.new_empty(channels, n + (0 if errors is None else errors.shape[1]), pixels)
    weighted[:, :n] = packed.detach().transpose(0, 1)
    weighted[:, :n] *= _inverse(scale)[:, None]
    if errors is not None:
        weighted[:, n:] = torch.where(scale[:, None] > 0, errors.mT, 0)
    return weighted


def _orthonormal(rows: Tensor) -> Tensor:
    """(U U^T)^(-1/2) U of rows (..., r, P) that are nearly orthonormal, or 0.

    The Gram matrix squares a condition number of 1 / CUT: rows that come from it are orthonormal to 1e-7 only, and
    that error depends on the order of sums.
    """
    excess = rows @ rows.mT - torch.diag_embed((rows != 0).any(-1).to(rows))
    return torch.baddbmm(rows, excess, rows, alpha=-0.5)


def _inverse(x: Tensor) -> Tensor:
    """1 / x, and 0 where x is 0."""
    zero = x == 0
    return torch.where(zero, 0, 1 / torch.where(zero, 1, x))
