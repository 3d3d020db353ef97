"""From a photograph to an observation: averages over the pixels of a view."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from torchbrdf.camera import Ball, wholly_inside
from torchbrdf.photograph._checks import check_photograph
from torchbrdf.photograph._summed_area import Boxes, SummedArea
from torchbrdf.photograph.silhouette import Circle
from torchbrdf.view import SphereView, View

LARGEST_DEFAULT_SIZE = 128
"""More pixels than this tell little more about a BRDF, and cost time."""

_PARTS = 2
"""Boxes along each side of a pixel of a view off the camera's axis."""


@dataclass(frozen=True)
class Observation:
    """A photograph, resampled to the pixels of a view.

    image  (3, H, W)  mean radiance of each pixel's area, 0 where not used
    mask   (1, H, W)  bool: pixels that usable parts of the photograph cover wholly
    """

    image: Tensor
    mask: Tensor


def observe(
    image: Tensor, silhouette: Circle | Ball, mask: Tensor | None = None, size: int | None = None
) -> Observation:
    """Average what shows a ball onto N x N pixels of a `SphereView`.

    image       (3, H, W)  linear radiance
    silhouette  a circle, for the view of an orthographic camera: its square. Or a ball before the photograph's camera,
                for the view in the ball's direction: what that camera shows when it is turned towards the ball
    mask        (1, H, W)  bool, True = use; None uses all
    size        N; None for the silhouette's own diameter, at most 128
    Averages are exact over each new pixel's area, as the radiance of a SphereView is; of a ball off the camera's axis
    a new pixel is taken for boxes with sides along the photograph's. A new pixel is used where all of it lies inside
    the photograph, the mask and the silhouette, and shows no pixel that the silhouette cuts, which holds background.
    Raises ValueError where such a pixel is not finite, none is left, or all are black; for an image that is not of
    floating-point numbers, and a mask that is not bool or of another size.
    """
    check_photograph(image, mask)
    n = min(LARGEST_DEFAULT_SIZE, round(2 * silhouette.circle[2])) if size is None else size
    return _averaged(image, mask, SphereView(n), boxes_of(silhouette, n), "ball", silhouette)


def boxes_of(silhouette: Circle | Ball, n: int) -> Boxes:
    """(N, N, S): what the N x N pixels of the view of a silhouette show of the photograph, in S equal parts each."""
    if isinstance(silhouette, Circle):
        corner = silhouette.x - silhouette.radius, silhouette.y - silhouette.radius
        return _grid(corner, 2 * silhouette.radius / n, (n, n))
    return tilted_boxes(silhouette.places, n)


def tilted_boxes(places: Callable[[Tensor, Tensor], Tensor], n: int, parts: int = _PARTS) -> Boxes:
    """`boxes_of` a view that shows x and y, to the right and up from -1 to 1, at places (..., 2) of the photograph.

    parts  along each side of a pixel
    """
    m = parts * n
    edges = torch.linspace(-1, 1, 2 * m + 1, dtype=torch.float64)
    middles, sides = edges[1::2], edges[::2]
    across = places(*torch.broadcast_tensors(sides, -middles[:, None]))[..., 0]
    down = places(*torch.broadcast_tensors(middles, -sides[:, None]))[..., 1]

    def by_pixel(sides: Tensor) -> Tensor:
        return sides.unflatten(1, (n, parts)).unflatten(0, (n, parts)).transpose(1, 2).flatten(2)

    return Boxes(*(by_pixel(side) for side in (across[:, :-1], across[:, 1:], down[:-1], down[1:])))


def observe_view(image: Tensor, view: View, mask: Tensor | None = None) -> Observation:
    """Average a whole photograph, taken by the view's own camera, onto the pixels of the view; see `observe`.

    image  (3, h, w)  linear radiance, of the proportions of the view
    mask   (1, h, w)  bool, True = use; None uses all
    Raises ValueError where the photograph has other proportions than the view, too.
    """
    check_photograph(image, mask)
    height, width = image.shape[-2:]
    if height * view.size[1] != width * view.size[0]:
        raise ValueError(
            f"the photograph is {height} x {width} and the view {view.size[0]} x {view.size[1]}; "
            "crop it to what the camera of the view shows"
        )
    return _averaged(image, mask, view, _grid((0.0, 0.0), width / view.size[1], view.size), "shape")


def _grid(corner: tuple[float, float], step: float, size: tuple[int, int]) -> Boxes:
    """Squares of `step` pixels, from a corner (x, y) on."""
    x, y = (
        start + step * torch.arange(n + 1, dtype=torch.float64) for start, n in zip(corner, size[::-1], strict=True)
    )
    return Boxes(x[:-1, None], x[1:, None], y[:-1, None, None], y[1:, None, None])


def _averaged(
    image: Tensor, mask: Tensor | None, view: View, boxes: Boxes, what: str, silhouette: Circle | Ball | None = None
) -> Observation:
    """The means over the boxes of each pixel of the view."""
    height, width = view.size
    around = boxes.within(image.shape[-2], image.shape[-1])
    image, boxes = image[:, *around], boxes.moved(-around[1].start, -around[0].start)
    usable = torch.ones_like(image[:1], dtype=torch.bool) if mask is None else mask[:, *around]
    if silhouette is not None:
        usable = usable & wholly_inside(silhouette.contains, *around)
    finite = torch.isfinite(image).all(0, keepdim=True)

    def averaged(values: Tensor) -> Tensor:
        return (SummedArea(values).over(boxes) / boxes.area).mean(-1)

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
