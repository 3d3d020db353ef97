"""What the camera sees: normals, view directions and the mask of a known shape.

The camera looks along -Z, image right is +X, image top is +Y. Radiance is averaged over a pixel's area, so a view
answers at any point inside a pixel, not only at its centre.
"""

import hashlib
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchbrdf.lasting import lasting
from torchbrdf.view.camera import Framing
from torchbrdf.view.packing import masked_pixels, pack, unpack

_COVERAGE_CELLS = 12
"""Along a side of the grid on which normals are counted."""

_COVERAGE_PLACES = 4
_COVERAGE_PIXELS = 4096
"""Pixels looked at, at most, and places along a side of each."""


@dataclass(frozen=True)
class SurfacePoints:
    """Points of a shape that the camera sees, in world space, component first.

    normals        (3, Q, S)  unit vectors of the smooth shape
    view_dirs      (3, Q, S)  unit vectors towards the camera
    positions      (3, Q, S)  where a shape can shade itself; None else
    facet_normals  (3, Q, S)  unit normals of the flat facets on which they lie; None like the positions
    """

    normals: Tensor
    view_dirs: Tensor
    positions: Tensor | None = None
    facet_normals: Tensor | None = None


class View(ABC):
    """A shape without interreflections, seen by a camera.

    mask     (1, H, W)  bool, True where the shape covers the whole pixel
    framing  the camera, for renderers that trace the shape; None where only its normals are known
    """

    mask: Tensor
    framing: Framing | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the image."""
        return self.mask.shape[-2], self.mask.shape[-1]

    @cached_property
    @lasting
    def pixels(self) -> Tensor:
        """(P,) int64: flat indices of the pixels under the mask, row by row."""
        return masked_pixels(self.mask)

    @property
    def fingerprint(self) -> str:
        """sha256 of everything that `surface` depends on."""
        return hashlib.sha256(self._identity()).hexdigest()

    @abstractmethod
    def surface(self, pixels: Tensor, u: Tensor, v: Tensor) -> SurfacePoints:
        """What is seen inside pixels.

        pixels  (Q,)    flat indices under the mask
        u, v    (Q, S)  position in the pixel, in [0, 1): from its left and from its top edge
        """

    def visibility(self, points: SurfacePoints, w_i: Tensor) -> Tensor | None:
        """Which points (Q, S) see the light from directions w_i (3, Q, S); None where no shape is in the way."""
        return None

    @abstractmethod
    def _identity(self) -> bytes: ...

    @cached_property
    @lasting
    def normals(self) -> Tensor:
        """(3, H, W) unit normals at the centres of the pixels, 0 outside the mask."""
        return self.unpack(self._centres.normals[..., 0])

    @cached_property
    @lasting
    def view_dirs(self) -> Tensor:
        """(3, H, W) unit vectors towards the camera at the centres of the pixels, 0 outside the mask."""
        return self.unpack(self._centres.view_dirs[..., 0])

    @cached_property
    @lasting
    def _centres(self) -> SurfacePoints:
        centre = torch.full((len(self.pixels), 1), 0.5, dtype=torch.float32)
        return self.surface(self.pixels, centre, centre)

    @cached_property
    def normal_coverage(self) -> float:
        """Share of the normals that a sphere would show that this shape shows, 0 to 1.

        Of the cells of a grid on the disc that a sphere fills in an image, those into which a normal falls, turned
        as if its pixel lay in the middle of the image. A plane fills one cell, a cube three at most.
        """
        places = (torch.arange(_COVERAGE_PLACES, dtype=torch.float32) + 0.5) / _COVERAGE_PLACES
        some = self.pixels[:: -(-len(self.pixels) // _COVERAGE_PIXELS)]
        u, v = (place.expand(len(some), -1) for place in torch.cartesian_prod(places, places).T)
        points = self.surface(some, u, v)
        z = points.view_dirs
        x = normalize(torch.stack([z[2], torch.zeros_like(z[0]), -z[0]]), dim=0)
        y = torch.linalg.cross(z, x, dim=0)
        disc = torch.stack([(points.normals * axis).sum(0).flatten() for axis in (x, y)])
        cells = ((disc + 1) * (_COVERAGE_CELLS / 2)).long().clamp_(0, _COVERAGE_CELLS - 1)
        found = len(torch.unique(cells[0] * _COVERAGE_CELLS + cells[1]))
        centres = (torch.arange(_COVERAGE_CELLS, dtype=torch.float32) + 0.5) * (2 / _COVERAGE_CELLS) - 1
        return min(1.0, found / int((centres[:, None].square() + centres.square() <= 1).sum()))

    def pack(self, image: Tensor) -> Tensor:
        """The pixels under the mask: (..., H, W) -> (..., P). Raises ValueError for an image of another size."""
        return pack(image, self.mask)

    def unpack(self, packed: Tensor) -> Tensor:
        """The inverse of `pack`, 0 outside the mask: (..., P) -> (..., H, W). Raises ValueError for another P."""
        return unpack(packed, self.mask)


