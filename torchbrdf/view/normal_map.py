"""`NormalMapView`: any known shape, given by its normals."""

import torch
from torch import Tensor
from torch.nn.functional import normalize

from torchbrdf.view.view import SurfacePoints, View


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
