"""Errors that neighbouring pixels share, by which photographs and basis images differ besides noise.

A shape or light that is not quite as it is said to be, cells that a table averages over: what is wrong by a per cent
at one pixel is as wrong at the next, and no number of pixels averages it away. Taken for noise of single pixels, it is
explained by the material, at the expense of what the photograph does not show. So residuals are

    e + SIZE g,     e white noise, g a Gaussian process of variance 1 and covariance exp(-|x - x'|^2 / (2 REACH^2)),

with x the place on the picture in units of half the object's extent. Both constants: docs/ablation.md.
"""

from collections.abc import Sequence
from math import factorial

import torch
from torch import Tensor

SIZE = 0.15
"""Standard deviation of the shared error, in units of the noise of a pixel."""

REACH = 1.0
"""In units of half the object's extent."""

_ORDER = 3
"""Of the covariance's Taylor series in x x', which leaves out 6 % of it; a fourth changes no figure."""


def smooth_errors(masks: Sequence[Tensor]) -> Tensor:
    """E (P, K) float64, E E^T the covariance of the shared errors of photographs, which have their own each.

    The Taylor series of exp(x x' / REACH^2) makes E of products of powers: exp(-x^2/2) x^i / sqrt(i!), x over REACH.

    masks  (1, H, W) bool of each photograph
    """
    return torch.block_diag(*(_of_one(mask) for mask in masks))


def _of_one(mask: Tensor) -> Tensor:
    places = torch.nonzero(mask[0]).double()
    extent = places.amax(0) - places.amin(0) + 1
    x, y = ((places - places.amin(0) + 0.5 - extent / 2) * (2 / (REACH * extent.amax()))).unbind(-1)
    fading = SIZE * torch.exp(-(x.square() + y.square()) / 2)
    powers = [(i, j) for i in range(_ORDER + 1) for j in range(_ORDER + 1 - i)]
    return torch.stack([fading * x**i * y**j / (factorial(i) * factorial(j)) ** 0.5 for i, j in powers], -1)
