"""Fields of vectors in files: the numbers as they are stored."""

import os
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from torchbrdf.images.formats import read_stored


def read_vectors(path: str | os.PathLike[str], layer: str | None = None) -> Tensor:
    """Read three numbers a pixel, without a colour space or an encoding.

    path     of any format of `read_image`; channels X, Y, Z of an .exr, or R, G, B; integers over their full scale
    layer    which of several of an .exr file
    returns  (3, H, W) float32; NaN where alpha is 0, and where an .exr file recorded nothing
    raises   FileNotFoundError; ValueError when the file is not such an image
    """
    path = Path(path)
    stored = read_stored(path, layer, vectors=True)
    if len(stored.values) != 3:
        raise ValueError(f"{path}: expected channels X, Y, Z or R, G, B, got one of grey")
    values = stored.values
    if stored.telling_alpha is not None:
        values = np.where(stored.telling_alpha > 0, values, np.float32(np.nan))
    return torch.from_numpy(values)
