"""Images whose numbers are no colours: normals, positions."""

import os

import numpy as np
import torch
from torch import Tensor

from torchbrdf.images.image_files import _existing, _read_exr, _read_opencv

VECTOR_SUFFIXES = (".exr", ".png")


def read_vectors(path: str | os.PathLike[str]) -> Tensor:
    """The numbers of R, G, B (or X, Y, Z) as they are stored, without gamma; integers over their full scale.

    path       .exr or .png
    returns    (3, H, W) float32; NaN where alpha is 0
    raises     FileNotFoundError; ValueError when the file is not such an image
    """
    path = _existing(path, VECTOR_SUFFIXES)
    if path.suffix.lower() == ".exr":
        channels = _read_exr(path)
        names = next((names for names in ("RGB", "XYZ") if set(names) <= set(channels)), None)
        if names is None:
            raise ValueError(f"{path}: expected channels R, G, B or X, Y, Z, got {sorted(channels)}")
        pixels, alpha = np.stack([channels[name] for name in names]), channels.get("A")
    else:
        stored = _read_opencv(path)
        if len(stored) not in (3, 4):
            raise ValueError(f"{path}: expected channels R, G, B, got {len(stored)} channel(s)")
        pixels, alpha = stored[:3], stored[3] if len(stored) == 4 else None
    if alpha is not None:
        pixels = np.where(alpha > 0, pixels, np.float32(np.nan))
    return torch.from_numpy(np.ascontiguousarray(pixels, dtype=np.float32))
