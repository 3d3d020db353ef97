"""ICC profiles of RGB: three primaries and a curve, read as [ICC22] defines them."""

from pathlib import Path

import numpy as np

from torchbrdf.images.encodings import LINEAR, SRGB, Transfer
from torchbrdf.images.formats._stored import Colours
from torchbrdf.images.primaries import Primaries

_HEADER_BYTES = 128
_D50 = (0.3457, 0.3585)
"""To which the primaries of all profiles are adapted."""
_SAME = 1e-3
_RAMP = np.linspace(0, 1, 65)


def colours_of_profile(path: Path, profile: bytes) -> Colours:
    """How values are encoded, and their colour space; raises ValueError for profiles that are no matrix and curves."""
    try:
        tags = _tags(profile)
        red, green, blue = (_chromaticity(tags[name]) for name in (b"rXYZ", b"gXYZ", b"bXYZ"))
        curve = _common_curve([tags[name] for name in (b"rTRC", b"gTRC", b"bTRC")])
        return Colours(curve, Primaries(red, green, blue, _D50))
    except (ValueError, LookupError, ArithmeticError):
        raise ValueError(
            f"{path}: its colour profile (ICC) is not three primaries and one curve; export it as sRGB, or linear"
        ) from None


def _tags(profile: bytes) -> dict[bytes, bytes]:
    if profile[16:20] != b"RGB ":
        raise ValueError("not RGB")
    table = profile[_HEADER_BYTES + 4 :]
    count = min(int.from_bytes(profile[_HEADER_BYTES : _HEADER_BYTES + 4], "big"), 100)
    entries = [table[12 * i : 12 * i + 12] for i in range(count)]
    places = {e[:4]: (int.from_bytes(e[4:8], "big"), int.from_bytes(e[8:12], "big")) for e in entries}
    return {name: profile[offset : offset + size] for name, (offset, size) in places.items()}


def _chromaticity(tag: bytes) -> tuple[float, float]:
    x, y, z = (np.frombuffer(tag[8:20], ">i4") / 65536).tolist()
    return x / (x + y + z), y / (x + y + z)


def _common_curve(tags: list[bytes]) -> Transfer:
    """The curve of all channels: a known one where it is that."""
    curves = [_curve(tag) for tag in tags]
    with np.errstate(all="ignore"):
        red, green, blue = (curve.decode(_RAMP) for curve in curves)
    if not (_agree(red, green) and _agree(red, blue)):
        raise ValueError("curves differ")
    return next((known for known in (LINEAR, SRGB) if _agree(red, known.decode(_RAMP))), curves[0])


def _agree(values: np.ndarray, others: np.ndarray) -> bool:
    return bool(np.abs(values - others).max() < _SAME)


def _curve(tag: bytes) -> Transfer:
    """A curve of the types `curv` (a gamma, or a table) and `para` (a gamma, with a line below a threshold)."""
    if tag[:4] == b"curv":
        count = int.from_bytes(tag[8:12], "big")
        if count == 0:
            return LINEAR
        numbers = np.frombuffer(tag[12 : 12 + 2 * count], ">u2")
        if len(numbers) != count:
            raise ValueError("truncated")
        if count == 1:
            return Transfer.power(float(numbers[0]) / 256)
        table = numbers / 65535
        return Transfer("its profile's curve", lambda values: np.interp(values, np.linspace(0, 1, count), table))
    if tag[:4] != b"para":
        raise ValueError("unknown curve")
    kind = int.from_bytes(tag[8:10], "big")
    g, a, b, c, d, e, f = _parameters(kind, (np.frombuffer(tag[12:40], ">i4") / 65536).tolist())
    if kind == 0:
        return Transfer.power(g)
    return Transfer(
        "its profile's curve",
        lambda values: np.where(values >= d, np.maximum(a * values + b, 0) ** g + e, c * values + f),
    )


def _parameters(kind: int, numbers: list[float]) -> tuple[float, ...]:
    """(a v + b)^g + e from d on, c v + f below, for the kinds of parametric curves."""
    n = numbers
    if kind == 0:
        return n[0], 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if kind == 1:
        return n[0], n[1], n[2], 0.0, -n[2] / n[1], 0.0, 0.0
    if kind == 2:
        return n[0], n[1], n[2], 0.0, -n[2] / n[1], n[3], n[3]
    if kind == 3:
        return n[0], n[1], n[2], n[3], n[4], 0.0, 0.0
    if kind == 4:
        return n[0], n[1], n[2], n[3], n[4], n[5], n[6]
    raise ValueError("unknown curve")
