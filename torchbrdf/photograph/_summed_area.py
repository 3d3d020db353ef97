"""Integrals of a picture over boxes, from a table of sums [Crow 1984]."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad


@dataclass(frozen=True)
class Boxes:
    """Boxes with sides along a picture's, in pixels, x to the right and y down; of one shape (...) when broadcast."""

    left: Tensor
    right: Tensor
    top: Tensor
    bottom: Tensor

    @property
    def area(self) -> Tensor:
        """(...), square pixels."""
        return (self.right - self.left) * (self.bottom - self.top)

    def within(self, height: int, width: int) -> tuple[slice, slice]:
        """Rows and columns of a picture that the boxes touch."""
        top, bottom = _touched(self.top, self.bottom, height)
        left, right = _touched(self.left, self.right, width)
        return slice(top, bottom), slice(left, right)

    def moved(self, right: int, down: int) -> "Boxes":
        """By whole pixels."""
        return Boxes(self.left + right, self.right + right, self.top + down, self.bottom + down)


def _touched(low: Tensor, high: Tensor, extent: int) -> tuple[int, int]:
    first = min(max(int(low.detach().min().floor()), 0), extent - 1)
    return first, min(max(int(high.detach().max().ceil()), first + 1), extent)


class SummedArea:
    """The sums over all pixels above and left of each corner of a picture (C, H, W), as float64.

    A pixel is a square of one value, so that integrals over boxes are exact, and so are their derivatives by the boxes'
    sides, which autograd finds: radiance along a side.
    """

    def __init__(self, picture: Tensor) -> None:
        """Sum up."""
        self._sums = pad(picture.double().cumsum(-1).cumsum(-2), (1, 0, 1, 0))

    def over(self, boxes: Boxes) -> Tensor:
        """(C, ...): the integrals over boxes, 0 outside the picture."""
        return (
            self._at(boxes.right, boxes.bottom)
            - self._at(boxes.left, boxes.bottom)
            - self._at(boxes.right, boxes.top)
            + self._at(boxes.left, boxes.top)
        )

    def _at(self, x: Tensor, y: Tensor) -> Tensor:
        height, width = self._sums.shape[-2:]
        x, y = x.clamp(0, width - 1), y.clamp(0, height - 1)
        column, row = (place.detach().floor().long().clamp_max(n - 2) for place, n in ((x, width), (y, height)))
        along, down = x - column, y - row
        upper = torch.lerp(self._sums[:, row, column], self._sums[:, row, column + 1], along)
        lower = torch.lerp(self._sums[:, row + 1, column], self._sums[:, row + 1, column + 1], along)
        return torch.lerp(upper, lower, down)
