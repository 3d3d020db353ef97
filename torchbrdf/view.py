"""What the camera sees: normals, view directions and the mask of a known shape.

The camera looks along -Z, image right is +X, image top is +Y. Radiance is averaged over a pixel's area, so a view
answers at any point inside a pixel, not only at its centre.
"""

import hashlib
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from math import radians, tan

import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchbrdf.camera import Framing, check_fov
from torchbrdf.packing import masked_pixels, pack, unpack

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
    def normals(self) -> Tensor:
        """(3, H, W) unit normals at the centres of the pixels, 0 outside the mask."""
        return self.unpack(self._centres.normals[..., 0])

    @cached_property
    def view_dirs(self) -> Tensor:
        """(3, H, W) unit vectors towards the camera at the centres of the pixels, 0 outside the mask."""
        return self.unpack(self._centres.view_dirs[..., 0])

    @cached_property
    def _centres(self) -> SurfacePoints:
        centre = torch.full((len(self.pixels), 1), 0.5)
        return self.surface(self.pixels, centre, centre)

    @cached_property
    def normal_coverage(self) -> float:
        """Share of the normals that a sphere would show that this shape shows, 0 to 1.

        Of the cells of a grid on the disc that a sphere fills in an image, those into which a normal falls, turned
        as if its pixel lay in the middle of the image. A plane fills one cell, a cube three at most.
        """
        places = (torch.arange(_COVERAGE_PLACES) + 0.5) / _COVERAGE_PLACES
        some = self.pixels[:: -(-len(self.pixels) // _COVERAGE_PIXELS)]
        u, v = (place.expand(len(some), -1) for place in torch.cartesian_prod(places, places).T)
        points = self.surface(some, u, v)
        z = points.view_dirs
        x = normalize(torch.stack([z[2], torch.zeros_like(z[0]), -z[0]]), dim=0)
        y = torch.linalg.cross(z, x, dim=0)
        disc = torch.stack([(points.normals * axis).sum(0).flatten() for axis in (x, y)])
        cells = ((disc + 1) * (_COVERAGE_CELLS / 2)).long().clamp_(0, _COVERAGE_CELLS - 1)
        found = len(torch.unique(cells[0] * _COVERAGE_CELLS + cells[1]))
        centres = (torch.arange(_COVERAGE_CELLS) + 0.5) * (2 / _COVERAGE_CELLS) - 1
        return min(1.0, found / int((centres[:, None].square() + centres.square() <= 1).sum()))

    def pack(self, image: Tensor) -> Tensor:
        """The pixels under the mask: (..., H, W) -> (..., P)."""
        return pack(image, self.mask)

    def unpack(self, packed: Tensor) -> Tensor:
        """The inverse of `pack`, 0 outside the mask: (..., P) -> (..., H, W)."""
        return unpack(packed, self.mask)


class SphereView(View):
    """A sphere that touches the borders of a square image.

    size     pixels along a side
    fov_deg  field of view across the image in degrees; None for an orthographic camera
    Pixels that the silhouette cuts are outside the mask.
    """

    framing: Framing

    def __init__(self, size: int, fov_deg: float | None = None) -> None:
        """Check the arguments and find the pixels that lie wholly inside the silhouette."""
        if size < 3:
            raise ValueError(f"a sphere needs an image of at least 3 x 3 pixels, got size={size}")
        check_fov(fov_deg)
        self.fov_deg = fov_deg
        self.framing = Framing.of_sphere(fov_deg)
        self._n = int(size)
        edge = torch.linspace(-1, 1, self._n + 1, dtype=torch.float64).abs()
        farthest = torch.maximum(edge[:-1], edge[1:]) ** 2
        self.mask = (farthest[:, None] + farthest <= 1)[None]

    def __repr__(self) -> str:
        """Size and camera."""
        camera = "orthographic" if self.fov_deg is None else f"fov_deg={self.fov_deg}"
        return f"SphereView({self._n}, {camera}, {len(self.pixels)} pixels)"

    def _identity(self) -> bytes:
        return f"sphere {self._n} {self.fov_deg}".encode()

    def surface(self, pixels: Tensor, u: Tensor, v: Tensor) -> SurfacePoints:
        """See View."""
        x = (2 / self._n) * ((pixels % self._n)[:, None] + u) - 1
        y = 1 - (2 / self._n) * ((pixels // self._n)[:, None] + v)
        if self.fov_deg is None:
            z = torch.sqrt((1 - x * x - y * y).clamp_min(0))
            toward_camera = torch.zeros(3, 1, 1, dtype=x.dtype, device=x.device)
            toward_camera[2] = 1
            return SurfacePoints(torch.stack([x, y, z]), toward_camera.expand(3, *x.shape))
        half = radians(self.fov_deg) / 2
        distance = self.framing.distance
        ray = normalize(torch.stack([x * tan(half), y * tan(half), -torch.ones_like(x)]), dim=0)
        along = -distance * ray[2]
        t = along - torch.sqrt((along * along - distance * distance + 1).clamp_min(0))
        hit = t * ray
        hit[2] += distance
        return SurfacePoints(normalize(hit, dim=0), -ray)


class NormalMapView(View):
    """Any known shape without shadows, given by its normals.

    normals    (3, H, W)  world space; normalised here
    mask       (1, H, W)  bool, True = use; None for all pixels with a normal
    view_dirs  (3, H, W)  unit vectors towards the camera; None for an orthographic camera (+Z)

    Inside a pixel the normal varies linearly, with the slopes of its neighbours under the mask; across a crease
    (neighbours more than 60 degrees apart) it stays constant.
    """

    _CREASE_COSINE = 0.5

    def __init__(self, normals: Tensor, mask: Tensor | None = None, view_dirs: Tensor | None = None) -> None:
        """Check shapes and values; pixels whose normal faces away from the camera leave the mask."""
        if normals.ndim != 3 or normals.shape[0] != 3:
            raise ValueError(f"normals must be (3, H, W), got {tuple(normals.shape)}")
        length = torch.linalg.vector_norm(normals, dim=0, keepdim=True)
        usable = torch.isfinite(length) & (length > 0)
        if mask is None:
            mask = usable
        if mask.shape != length.shape or mask.dtype != torch.bool:
            raise ValueError(f"mask must be bool {tuple(length.shape)}, got {mask.dtype} {tuple(mask.shape)}")
        if view_dirs is None:
            view_dirs = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(normals.shape)
        elif view_dirs.shape != normals.shape:
            raise ValueError(f"view_dirs must be {tuple(normals.shape)} like normals, got {tuple(view_dirs.shape)}")
        distance = torch.linalg.vector_norm(view_dirs, dim=0, keepdim=True)
        seen = torch.isfinite(distance) & (distance > 0)
        for what, sound in (("normals", usable), ("view_dirs", seen)):
            unsound = int((mask & ~sound).sum())
            if unsound:
                raise ValueError(f"{what} are zero or not finite in {unsound} pixels of the mask; take those out of it")
        self._normals = torch.where(usable, normals / length, 0).float()
        self._view_dirs = torch.where(seen, view_dirs / distance, 0).float()
        self.mask = mask & ((self._normals * self._view_dirs).sum(0, keepdim=True) > 0)
        if not self.mask.any():
            raise ValueError("no pixel under the mask has a normal that faces the camera")
        self._slopes = torch.stack([self._slope(-1), self._slope(-2)])

    def __repr__(self) -> str:
        """Size and number of pixels."""
        return f"NormalMapView({self.size[0]} x {self.size[1]}, {len(self.pixels)} pixels)"

    def _identity(self) -> bytes:
        tensors = (self._normals, self._view_dirs, self.mask)
        return b"normals " + b"".join(tensor.contiguous().numpy().tobytes() for tensor in tensors)

    def _slope(self, axis: int) -> Tensor:
        """Change of the normal (3, H, W) over one pixel along an axis: the mean over the smooth neighbours."""
        here, used = self._normals, self.mask
        total, count = torch.zeros_like(here), torch.zeros_like(used, dtype=here.dtype)
        for step in (1, -1):
            there = here.roll(-step, axis)
            smooth = used & used.roll(-step, axis) & ((here * there).sum(0, keepdim=True) > self._CREASE_COSINE)
            border = [slice(None)] * 3
            border[axis] = slice(-1, None) if step == 1 else slice(0, 1)
            smooth[tuple(border)] = False
            total += torch.where(smooth, step * (there - here), 0)
            count += smooth
        return total / count.clamp_min(1)

    def surface(self, pixels: Tensor, u: Tensor, v: Tensor) -> SurfacePoints:
        """See View."""
        device = pixels.device
        base = self._normals.flatten(1).to(device)[:, pixels, None]
        slopes = self._slopes.flatten(2).to(device)[:, :, pixels, None]
        normals = normalize(base + slopes[0] * (u - 0.5) + slopes[1] * (v - 0.5), dim=0)
        return SurfacePoints(normals, self._view_dirs.flatten(1).to(device)[:, pixels, None].expand_as(normals))
