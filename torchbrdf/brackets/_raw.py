"""Camera RAW, by LibRaw: linear values of the camera's own colours, and what makes Rec. 709 of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Development:
    """From a camera's colours to linear Rec. 709.

    white_balance  of R, G and B, with 1 for G
    matrix         (3, 3) nested tuples: from balanced colours of the camera; each row sums to 1
    """

    white_balance: tuple[float, float, float]
    matrix: tuple[tuple[float, ...], ...]

    @classmethod
    def of(cls, said: Mapping[str, Any]) -> Development:
        """From its own fields, as JSON keeps them; raises ValueError for others."""
        found = cls(tuple(map(float, said["white_balance"])), tuple(tuple(map(float, row)) for row in said["matrix"]))  # type: ignore[arg-type]
        if np.shape(found.matrix) != (3, 3) or len(found.white_balance) != 3:
            raise ValueError(f"expected 3 and 3 x 3 numbers, got {said}")
        return found

    def __call__(self, radiance: np.ndarray) -> np.ndarray:
        """Of (H, W, 3)."""
        whole = np.array(self.matrix) * np.array(self.white_balance)
        return radiance @ whole.T.astype(radiance.dtype)


def read_raw(path: Path) -> tuple[np.ndarray, float, Development]:
    """(H, W, 3) uint16 over black, not balanced; the white level over black; how to develop them."""
    if find_spec("rawpy") is None:
        raise ValueError(f"{path}: camera RAW is read by rawpy; install it: pip install 'torchbrdf[raw]'")
    import rawpy

    try:
        with rawpy.imread(str(path)) as raw:
            black = float(np.mean(raw.black_level_per_channel))
            white = float(raw.white_level) - black
            gains, matrix = np.array(raw.camera_whitebalance[:3]), np.array(raw.color_matrix)[:, :3]
            if not (gains > 0).all():
                gains = np.array(raw.daylight_whitebalance[:3])
            codes = raw.postprocess(
                gamma=(1, 1),
                no_auto_bright=True,
                no_auto_scale=True,
                output_bps=16,
                output_color=rawpy.ColorSpace.raw,
                user_wb=[1, 1, 1, 1],
            )
    except (rawpy.LibRawError, OSError, ValueError, TypeError):
        raise ValueError(
            f"{path}: not a readable camera RAW file (truncated, damaged, or of an unknown camera)"
        ) from None
    if not matrix.any() or not (gains > 0).all():
        raise ValueError(f"{path}: LibRaw does not know the colours of this camera; develop it to a linear 16-bit .tif")
    red, _, blue = (gains / gains[1]).tolist()
    return codes, white, Development((red, 1.0, blue), tuple(tuple(row) for row in matrix.tolist()))
