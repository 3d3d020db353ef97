"""From a photograph to an observation: averages over the pixels of a view."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.photograph.silhouette import Circle
from torchbrdf.view import SphereView, View

LARGEST_DEFAULT_SIZE = 128
"""More pixels than this tell little more about a BRDF, and cost time."""

@dataclass(frozen=True)
class Observation:
    """A photograph, resampled to the pixels of a view.

    image  (3, H, W)  mean radiance of each pixel's area, 0 where not used
    mask   (1, H, W)  bool: pixels that usable parts of the photograph cover wholly
    """

    image: Tensor
    mask: Tensor


def observe(image: Tensor, circle: Circle, mask: Tensor | None = None, size: int | None = None) -> Observation:
    """Average the square around a circle onto N x N pixels.

    image    (3, H, W)  linear radiance
    mask     (1, H, W)  bool, True = use; None uses all
    size     N; None for the circle's own diameter, at most 128
    Averages are exact over each new pixel's area, as the radiance of a SphereView is. A new pixel is used where all
    of it lies inside the photograph, the mask and the silhouette.
    Raises ValueError where such a pixel is not finite, none is left, or all are black.
    """
    n = min(LARGEST_DEFAULT_SIZE, round(2 * circle.radius)) if size is None else size
    corner = circle.x - circle.radius, circle.y - circle.radius
    return _averaged(image, mask, SphereView(n), corner, 2 * circle.radius / n, "ball")


def observe_view(image: Tensor, view: View, mask: Tensor | None = None) -> Observation:
    """Average a whole photograph, taken by the view's own camera, onto the pixels of the view; see `observe`.

    Raises ValueError where the photograph has other proportions than the view, too.
    """
    height, width = image.shape[-2:]
    if height * view.size[1] != width * view.size[0]:
        raise ValueError(
            f"the photograph is {height} x {width} and the view {view.size[0]} x {view.size[1]}; "
            "crop it to what the camera of the view shows"
        )
    return _averaged(image, mask, view, (0.0, 0.0), width / view.size[1], "shape")


def _averaged(
    image: Tensor, mask: Tensor | None, view: View, corner: tuple[float, float], step: float, what: str
) -> Observation:
    """The part of the image from a corner (x, y) on, with `step` pixels of it for each pixel of the view."""
    height, width = view.size
    usable = torch.ones_like(image[:1], dtype=torch.bool) if mask is None else mask
    finite = torch.isfinite(image).all(0, keepdim=True)
    rows = _box_weights(corner[1], step, height, image.shape[-2])
    columns = _box_weights(corner[0], step, width, image.shape[-1])

    def averaged(values: Tensor) -> Tensor:
        return rows @ values.double() @ columns.T

    used = (averaged(usable) > 1 - 1e-6) & view.mask
    unsound = int((used & (averaged(usable & ~finite) > 0)).sum())
    if unsound:
        raise ValueError(f"NaN or infinite values in {unsound} of the {height} x {width} pixels; mask them out")
    if not used.any():
        raise ValueError(
            f"no whole pixel of the {what} is left at {height} x {width}: the mask is too small or full of holes"
        )
    observed = torch.where(used, averaged(torch.where(usable & finite, image, 0)), 0).to(image.dtype)
    if not observed.any():
        raise ValueError(f"the {what} is black: every usable pixel is 0")
    return Observation(observed, used)


def _box_weights(start: float, step: float, n: int, extent: int) -> Tensor:
    """(n, extent) float64: which share of each of n boxes of width `step` each pixel fills; rows sum to 1 inside."""
    edges = torch.arange(extent, dtype=torch.float64)
    low = start + step * torch.arange(n, dtype=torch.float64)[:, None]
    overlap = torch.minimum(low + step, edges + 1) - torch.maximum(low, edges)
    return overlap.clamp_min(0) / step
