"""One exposure of a bracket: its pixels as they are stored, and what its file says of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from torchbrdf.brackets._raw import Development, read_raw
from torchbrdf.images import RAW_SUFFIXES, Primaries, Shooting, Transfer, read_shooting
from torchbrdf.images.formats import read_stored

_CLIPPED = 0.98
"""Of the highest code: JPEG rings around it."""
_HELD = 20
"""Pixels at the highest value of a picture that show that it is clipped there."""
_LOWEST_CLIP = 0.5


@dataclass(frozen=True)
class Frame:
    """One exposure.

    path         its file
    codes        (H, W, 3)  uint8 or uint16 as stored, or float32
    full_scale   what codes are over, to be in [0, 1]
    kind         what messages call the file, such as "8-bit JPEG"
    shooting     how it was taken
    transfer     how the file says that integers stand for radiance; None where it does not say
    primaries    its colour space; None where it does not say
    development  what makes colours of a camera's own, for camera RAW
    """

    path: Path
    codes: np.ndarray
    full_scale: float
    kind: str
    shooting: Shooting
    transfer: Transfer | None = None
    primaries: Primaries | None = None
    development: Development | None = None

    @property
    def integers(self) -> bool:
        """Whether a curve may stand between its codes and radiance."""
        return self.codes.dtype.kind == "u" and self.development is None

    @property
    def step(self) -> float:
        """The distance of neighbouring codes, in [0, 1]; 0 for floating-point ones."""
        return 1 / self.full_scale if self.codes.dtype.kind == "u" else 0.0


def open_frame(path: Path) -> Frame:
    """Read one exposure; raises as `read_stored`, and ValueError for grey pictures and camera RAW without rawpy."""
    shooting = read_shooting(path)
    if path.suffix.lower() in RAW_SUFFIXES:
        codes, full_scale, development = read_raw(path)
        return Frame(path, codes, full_scale, "camera RAW", shooting, development=development)
    stored = read_stored(path)
    if len(stored.values) != 3:
        raise ValueError(f"{path}: expected R, G, B channels, got one of grey; give photographs in colour")
    transfer, primaries = stored.colours()
    values = stored.values.transpose(1, 2, 0)
    if not stored.full_scale:
        return Frame(path, np.ascontiguousarray(values), 1.0, stored.kind, shooting, None, primaries)
    kind = np.uint8 if stored.full_scale < 256 else np.uint16
    codes = np.ascontiguousarray(np.rint(values * stored.full_scale).astype(kind))
    return Frame(path, codes, float(stored.full_scale), stored.kind, shooting, transfer, primaries)


def clip_levels(frames: Sequence[Frame]) -> np.ndarray:
    """(3,): from which value in [0, 1] on codes of a channel are clipped; inf where floating-point ones never are.

    A channel may end below the highest code, where many pixels of one picture have the same highest value.
    """
    return np.array([min(_clip_level(frame, channel) for frame in frames) for channel in range(3)])


def _clip_level(frame: Frame, channel: int) -> float:
    codes = frame.codes[..., channel]
    highest = float(np.nanmax(codes))
    held = int((codes == highest).sum()) >= max(_HELD, 1e-5 * codes.size)
    if frame.codes.dtype.kind != "u":
        return highest * (1 - 1e-6) if held and highest > 0 else np.inf
    below = int((codes == highest - 1).sum())
    if held and highest >= _LOWEST_CLIP * frame.full_scale and (codes == highest).sum() > 3 * below:
        return _CLIPPED * highest / frame.full_scale
    return _CLIPPED
