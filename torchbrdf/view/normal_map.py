"""`NormalMapView`: any known shape, given by its normals."""

import os
import warnings
from pathlib import Path
from typing import Self

import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchbrdf.images import read_vectors
from torchbrdf.view._normal_encoding import decoded, surroundings
from torchbrdf.view._normal_frame import flat_surroundings, righted
from torchbrdf.view.view import SurfacePoints, View


class NormalMapView(View):
    """Any known shape without shadows, given by its normals.

    normals    (3, H, W)  X right, Y up, Z towards the camera; of unit length, or all of any length: normalised here
    mask       (1, H, W)  bool, True = use; None for all pixels with a normal
    view_dirs  (3, H, W)  unit vectors towards the camera; None for an orthographic camera (+Z)

    Inside a pixel the normal varies linearly, with the slopes of its neighbours under the mask; across a crease
    (neighbours more than 60 degrees apart) it stays constant.

    Numbers that can only be n/2 + 1/2 are decoded, and a frame with Y down is turned where slopes and silhouette leave
    no doubt, both with a warning that says so. Where unit vectors are stored, pixels of other lengths leave the mask.
    """

    _CREASE_COSINE = 0.5

    def __init__(self, normals: Tensor, mask: Tensor | None = None, view_dirs: Tensor | None = None) -> None:
        """Check shapes, values and frame; pixels whose normal faces away from the camera leave the mask."""
        self._build(normals, mask, view_dirs)

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> Self:
        """Read a normal map: X, Y, Z in the channels R, G, B (or X, Y, Z) of an orthographic camera.

        Raises FileNotFoundError; ValueError where the numbers are no normals with certainty, or in another frame.
        """
        view = cls.__new__(cls)
        try:
            view._build(read_vectors(path), None, None, Path(path))
        except ValueError as error:
            raise ValueError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
        return view

    def _build(self, normals: Tensor, mask: Tensor | None, view_dirs: Tensor | None, path: Path | None = None) -> None:
        """path: of a file, whose numbers must be normals with certainty."""
        if normals.ndim != 3 or normals.shape[0] != 3:
            raise ValueError(f"normals must be (3, H, W), got {tuple(normals.shape)}")
        if mask is not None and (mask.shape != (1, *normals.shape[1:]) or mask.dtype != torch.bool):
            expected = (1, *normals.shape[1:])
            raise ValueError(f"mask must be bool {expected}, got {mask.dtype} {tuple(mask.shape)}")
        if view_dirs is None:
            view_dirs = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float32)[:, None, None].expand(normals.shape)
        elif view_dirs.shape != normals.shape:
            raise ValueError(f"view_dirs must be {tuple(normals.shape)} like normals, got {tuple(view_dirs.shape)}")
        lengths, distance = (torch.linalg.vector_norm(each, dim=0, keepdim=True) for each in (normals, view_dirs))
        seen = torch.isfinite(distance) & (distance > 0)
        given = torch.isfinite(lengths) & (lengths > 0)
        for what, sound in (("normals", given), ("view_dirs", seen)):
            unsound = 0 if mask is None else int((mask & ~sound).sum())
            if unsound:
                raise ValueError(f"{what} are zero or not finite in {unsound} pixels of the mask; take those out of it")
        vectors, note = decoded(normals, mask, strict=path is not None)
        lengths = torch.linalg.vector_norm(vectors, dim=0, keepdim=True)
        usable = torch.isfinite(lengths) & (lengths > 0) & given
        vectors = torch.where(usable, vectors / lengths, 0).float()
        notes = [note] if note else []
        if mask is None:
            around = surroundings(vectors, usable[0])
            if around.any() and flat_surroundings(vectors, around):
                usable = usable & ~around
                notes.append(f"{int(around.sum())} pixels around the shape that face the camera were left out")
        self._view_dirs = torch.where(seen, view_dirs / distance, 0).float()
        frame = righted(vectors, self._view_dirs, usable if mask is None else mask & usable)
        self._normals = torch.where(usable, frame.normals, 0)
        self.mask = (usable if mask is None else mask & usable) & (
            (self._normals * self._view_dirs).sum(0, keepdim=True) > 0
        )
        if not self.mask.any():
            raise ValueError("no pixel under the mask has a normal that faces the camera")
        for each in notes + frame.notes:
            warnings.warn(f"{path or 'normal map'}: {each}", UserWarning, stacklevel=3)
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
