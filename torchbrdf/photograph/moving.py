"""What a photograph shows of a ball whose silhouette is not quite known, and how that changes with the silhouette."""

from __future__ import annotations

from copy import copy
from functools import cached_property
from math import atan, degrees, exp, log, radians, tan

import torch
from torch import Tensor

from torchbrdf.camera import Ball
from torchbrdf.photograph._summed_area import Boxes, SummedArea
from torchbrdf.photograph.finding import find_near
from torchbrdf.photograph.observation import tilted_boxes
from torchbrdf.photograph.silhouette import Circle
from torchbrdf.view import SphereView

REACH = 0.08
"""Radii by which a silhouette can move and grow."""

_SOFT = 1 - 0.5**0.5
"""Pixels of the photograph to each side over which what is seen is smeared: the noise of a mean over a box whose sides
lie on edges of pixels is then that of one whose sides cut pixels in half. Without, no place looks as noisy as a right
one."""

_WHOLE = 1 - 1e-6


class MovingSilhouette:
    """A ball in a photograph, N x N pixels of it wherever its silhouette is within reach.

    guess   the silhouette from which shifts (3,) count: to the right, up, both in its radii as the camera turned
            towards it sees them, and the logarithm of the growth of the radius
    used    (P,) bool: the pixels of the view whose area is usable wherever the silhouette is; background counts, so
            that the same pixels are compared everywhere. Exact blackness does not: it is what a cut-out leaves around
            a ball, and its edge is that of whole pixels
    """

    def __init__(self, image: Tensor, guess: Circle | Ball, mask: Tensor | None, n: int) -> None:
        """See `observe` for what they are. Raises ValueError where there is no such pixel."""
        usable = torch.isfinite(image).all(0, keepdim=True) & (image != 0).any(0, keepdim=True)
        if mask is not None:
            usable &= mask
        self.guess, self._soft = guess, _SOFT
        self._n, self._pixels, self._corner = n, SphereView(n).pixels, (0, 0)
        none = torch.zeros(3, dtype=torch.float64)
        blurred = self._farthest + 2 * self.radius / n
        around = self._boxes(none, blurred).within(image.shape[-2], image.shape[-1])
        self._corner = around[1].start, around[0].start
        grown = self._boxes(none, self._farthest)
        self.used = ((SummedArea(usable[:, *around]).over(grown) / grown.area).amin(-1) > _WHOLE)[0]
        if not bool(self.used.any()):
            raise ValueError(
                f"the {guess} cannot be searched: none of its pixels is usable wherever it may lie within "
                f"{REACH:.0%} of its radius; leave more of the photograph around it"
            )
        self._pixels = self._pixels[self.used]
        self._image, self._usable = image, usable
        self._sums = SummedArea(torch.where(usable, image, 0)[:, *around])

    def smeared(self, pixels: float) -> MovingSilhouette:
        """The same, smeared over so many pixels of the view to each side where that is more."""
        other = copy(self)
        other._soft = max(_SOFT, pixels * 2 * self.radius / self._n)
        return other

    def at(self, shift: Tensor) -> Circle | Ball:
        """The silhouette after a shift."""
        right, up, growth = shift.tolist()
        if isinstance(self.guess, Circle):
            x, y, radius = self.guess.x, self.guess.y, self.guess.radius
            return Circle(x + right * radius, y - up * radius, radius * exp(growth))
        wide = tan(radians(self.guess.radius_deg))
        middle = self.guess.rotation @ torch.tensor([wide * right, wide * up, -1.0], dtype=torch.float64)
        x, y, z = middle.tolist()
        return Ball(self.guess.camera, (x, y, z), degrees(atan(wide * exp(growth))))

    @cached_property
    def edge(self) -> tuple[Tensor, Tensor] | None:
        """The shift (3,) to the outline that is seen in the photograph, and its standard deviations (3,).

        None where none is seen for certain, or out of reach.
        """
        found = find_near(self._image, self.guess, self._usable)
        if found is None:
            return None
        shift = self.shift_to(found.silhouette)
        std = torch.tensor(found.std, dtype=torch.float64) / found.circle.radius
        return (shift, std) if float(shift.abs().max()) < REACH else None

    def shift_to(self, silhouette: Circle | Ball) -> Tensor:
        """(3,): the shift `at` which it is; of a ball before the same camera as the guess."""
        if isinstance(self.guess, Circle) or isinstance(silhouette, Circle):
            (x, y, radius), (guess_x, guess_y, unit) = silhouette.circle, self.guess.circle
            right, up, growth = (x - guess_x) / unit, (guess_y - y) / unit, radius / unit
        else:
            unit = tan(radians(self.guess.radius_deg))
            seen = self.guess.rotation.T @ torch.tensor(silhouette.direction, dtype=torch.float64)
            right, up = (seen[:2] / (-seen[2] * unit)).tolist()
            growth = tan(radians(silhouette.radius_deg)) / unit
        return torch.tensor([right, up, log(growth)], dtype=torch.float64)

    def seen(self, shift: Tensor) -> Tensor:
        """(3, P): mean radiance of the pixels used, for a shift."""
        boxes = self._boxes(shift, None)
        return (self._sums.over(boxes) / boxes.area).mean(-1)

    def change(self, shift: Tensor) -> Tensor:
        """(3, 3, P): derivatives of `seen` by the shift, exact: radiance along the sides of boxes."""
        at = shift.detach().requires_grad_()
        with torch.enable_grad():
            seen = self.seen(at)
            back = torch.zeros_like(seen, requires_grad=True)
            pulled = torch.autograd.grad(seen, at, back, create_graph=True)[0]  # linear in `back`: its transpose pushes
        pushed = [torch.autograd.grad(each, back, retain_graph=True)[0] for each in pulled]
        return torch.stack(pushed)

    @cached_property
    def radius(self) -> float:
        """Of the guess, in pixels of the photograph."""
        return self.guess.circle[2]

    @property
    def _farthest(self) -> Tensor:
        """(P, 1): by how many pixels of the photograph each pixel can move."""
        middles = (torch.arange(self._n, dtype=torch.float64) + 0.5) * (2 / self._n) - 1
        distance = torch.hypot(middles, middles[:, None]).flatten()[self._pixels]
        return (REACH * self.radius * (1 + distance) + _SOFT)[:, None]

    def _boxes(self, shift: Tensor, grown: Tensor | None) -> Boxes:
        """(P, S): of the pixels, grown by so many pixels of the photograph to each side, else smeared."""
        size = torch.exp(shift[2])

        def places(x: Tensor, y: Tensor) -> Tensor:
            return self.guess.places(size * x + shift[0], size * y + shift[1])

        boxes = tilted_boxes(places, self._n, 1) if isinstance(self.guess, Circle) else tilted_boxes(places, self._n)
        left, right, top, bottom = (
            side.flatten(0, 1)[self._pixels] for side in (boxes.left, boxes.right, boxes.top, boxes.bottom)
        )
        x, y = self._corner
        left, right, top, bottom = left - x, right - x, top - y, bottom - y
        if grown is not None:
            return Boxes(left - grown, right + grown, top - grown, bottom + grown)
        one = torch.tensor([-self._soft, self._soft], dtype=torch.float64)
        across, down = one.repeat(2), one.repeat_interleave(2)
        sides = (left, across), (right, across), (top, down), (bottom, down)
        moved = [(side[..., None] + by).flatten(1) for side, by in sides]
        return Boxes(*moved)
