"""How normals are stored: which of the usual ways explains the numbers of a map."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

EXPECTED = (
    "expected unit normals with X right, Y up and Z towards the camera, from -1 to 1 (.exr), "
    "or n/2 + 1/2 from 0 to 1"
)

_NEAR = 0.05
"""Lengths that differ less from 1 count as 1: rounding to 8 bits changes them by up to 0.008."""

_MOST = 0.7
"""Share of the pixels that must be explained."""

_SHORTEST, _LONGEST = 0.9, 1.1
"""Pixels of other lengths mix normals with their surroundings."""

_MEAN = (0.6, 1.03)
"""Lengths that means of unit vectors over a pixel have."""

_EXACT = 1e-3
"""Numbers that differ less are the same, relative to their size."""

_ENOUGH = 1 << 18
"""Pixels looked at."""

_SURROUNDINGS = 0.25
"""Share of the border that one and the same vector takes where it is what surrounds the shape."""


@dataclass(frozen=True)
class _Encoding:
    """A way to store a unit vector: numbers of 0 to `scale`, and back."""

    name: str
    scale: float
    decode: Callable[[Tensor], Tensor]


def _from_srgb(stored: Tensor) -> Tensor:
    """Linear light as the numbers of an sRGB picture."""
    light = stored.clamp(0, 1)
    return torch.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


_ENCODINGS = (
    _Encoding("n/2 + 1/2", 1, lambda v: 2 * v - 1),
    _Encoding("n/2 + 1/2 times 255", 255, lambda v: v / 127.5 - 1),
    _Encoding("n/2 + 1/2 times 65535", 65535, lambda v: v / 32767.5 - 1),
    _Encoding("n/2 + 1/2 with the sRGB curve undone", 1, lambda v: 2 * _from_srgb(v) - 1),
    _Encoding("n/2 + 1/2 to the power 2.2", 1, lambda v: 2 * v.clamp(0, 1) ** (1 / 2.2) - 1),
)


def decoded(stored: Tensor, mask: Tensor | None, strict: bool) -> tuple[Tensor, str]:
    """The vectors that a map stores, (3, H, W), and what was done, "" where the numbers are taken as they are.

    stored  (3, H, W)  as read
    mask    (1, H, W)  pixels that count; None for all
    strict  refuse numbers that are neither unit vectors nor decoded with certainty; else they are left as they are
            where they may be vectors of any length

    Where unit vectors are stored, in whatever way, pixels of other lengths become 0: they show no normal, or the
    silhouette cuts them.
    """
    shown = torch.isfinite(stored).all(0) & (stored != 0).any(0)
    if mask is not None:
        shown &= mask[0]
    sample = stored[:, *_evidence(stored, shown)].double()
    if sample.shape[1] == 0:
        return stored, ""
    encoding, is_unit = _explanation(sample), _unit_share(sample) >= _MOST
    if is_unit and encoding is not None:
        near, far = sorted([_deviation(sample), _deviation(encoding.decode(sample))])
        clear = far > 4 * near + _EXACT
        if strict and not clear:
            raise ValueError(f"its numbers may be normals or {encoding.name}, both have unit length; {EXPECTED}")
        is_unit = not clear or _deviation(sample) == near
    if is_unit:
        return _trimmed(stored, _SHORTEST), ""
    if encoding is not None:
        return _decoded_by(encoding, stored)
    if _is_mean(sample):
        return _trimmed(stored, _MEAN[0]), ""
    if _within(sample, 1) and _is_mean(_ENCODINGS[0].decode(sample)):
        return _decoded_by(_ENCODINGS[0], stored)
    lengths = sample.norm(dim=0)
    for what, values in (("Z is", sample[2]), ("all lengths are", lengths)):
        if float(values.min()) > 0 and float(values.max() - values.min()) <= _EXACT * float(values.max()):
            note = f"its vectors were brought to unit length ({what} {float(values.median()):.4g})"
            return stored, note if strict else ""
    spread = (sample.amax(1) - sample.amin(1))[:2]
    if strict or (_within(sample, 1) and bool((spread > 0.3).all())):
        low, high = lengths.quantile(torch.tensor([0.01, 0.99], dtype=lengths.dtype)).tolist()
        raise ValueError(f"its numbers are no known normals, with lengths of {low:.3g} to {high:.3g}; {EXPECTED}")
    return stored, ""


def surroundings(vectors: Tensor, shown: Tensor) -> Tensor:
    """(H, W) bool: pixels with the vector that most of the border has, where other pixels have others."""
    border = torch.ones_like(shown)
    border[1:-1, 1:-1] = False
    found, counts = torch.unique(vectors[:, border & shown], dim=1, return_counts=True)
    none = torch.zeros_like(shown)
    if counts.numel() == 0 or int(counts.max()) < _SURROUNDINGS * int(border.sum()):
        return none
    same = (vectors == found[:, counts.argmax(), None, None]).all(0) & shown
    return none if bool((same == shown).all()) else same


def _evidence(stored: Tensor, shown: Tensor) -> tuple[Tensor, Tensor]:
    """Rows and columns of pixels inside the shape, away from its silhouette where enough are."""
    shape = shown & ~surroundings(stored, shown)
    inner = shape.clone()
    for axis in (0, 1):
        for step in (1, -1):
            inner &= shape.roll(step, axis)
    chosen = inner if int(inner.sum()) >= 16 else shape
    rows, columns = chosen.nonzero(as_tuple=True)
    stride = -(-len(rows) // _ENOUGH) or 1
    return rows[::stride], columns[::stride]


def _explanation(sample: Tensor) -> _Encoding | None:
    """The encoding that gives most vectors unit length; None where none does.

    One vector alone proves nothing, but for the one that all flat maps hold.
    """
    vectors = {each: each.decode(sample) for each in _ENCODINGS if _within(sample, each.scale)}
    if not vectors:
        return None
    best = max(vectors, key=lambda each: (round(_unit_share(vectors[each]), 1), -_deviation(vectors[each])))
    proven = not _is_constant(sample) or float(vectors[best][2].min()) > 1 - _NEAR
    return best if proven and _unit_share(vectors[best]) >= _MOST else None


def _within(sample: Tensor, scale: float) -> bool:
    return float(sample.min()) >= -_EXACT * scale and float(sample.max()) <= (1 + _EXACT) * scale


def _unit_share(vectors: Tensor) -> float:
    return float(((vectors.norm(dim=0) - 1).abs() < _NEAR).double().mean())


def _deviation(vectors: Tensor) -> float:
    return float((vectors.norm(dim=0) - 1).abs().median())


def _is_mean(vectors: Tensor) -> bool:
    lengths = vectors.norm(dim=0)
    return float(((lengths >= _MEAN[0]) & (lengths <= _MEAN[1])).double().mean()) >= 0.9


def _is_constant(sample: Tensor) -> bool:
    return float((sample.amax(1) - sample.amin(1)).max()) <= _EXACT * float(sample.abs().max())


def _trimmed(vectors: Tensor, shortest: float) -> Tensor:
    lengths = vectors.norm(dim=0, keepdim=True)
    return torch.where((lengths >= shortest) & (lengths <= _LONGEST), vectors, 0)


def _decoded_by(encoding: _Encoding, stored: Tensor) -> tuple[Tensor, str]:
    return _trimmed(encoding.decode(stored), _SHORTEST), f"its numbers are {encoding.name} and were decoded"
