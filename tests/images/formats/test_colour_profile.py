"""ICC profiles, made by Little CMS and by hand."""

import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import ImageCms

from torchbrdf.images.encodings import SRGB
from torchbrdf.images.formats._colour_profile import colours_of_profile
from torchbrdf.images.primaries import SPACES

PATH = Path("photo.png")
RAMP = np.linspace(0, 1, 1001)
SRGB_COLORANTS = ((0.43607, 0.22249, 0.01392), (0.38515, 0.71687, 0.09708), (0.14307, 0.06061, 0.71410))
P3_COLORANTS = ((0.51512, 0.24120, -0.00105), (0.29198, 0.69225, 0.04189), (0.15710, 0.06657, 0.78407))
"""XYZ adapted to D50, as the profiles of these spaces hold them."""


def fixed(*numbers: float) -> bytes:
    return struct.pack(f">{len(numbers)}i", *(round(n * 65536) for n in numbers))


def gamma(value: float) -> bytes:
    return b"curv\0\0\0\0" + struct.pack(">IH", 1, round(value * 256))


def table(values: np.ndarray) -> bytes:
    return b"curv\0\0\0\0" + struct.pack(">I", len(values)) + (values * 65535).round().astype(">u2").tobytes()


def parametric(kind: int, *numbers: float) -> bytes:
    return b"para\0\0\0\0" + struct.pack(">HH", kind, 0) + fixed(*numbers)


def profile(*curves: bytes, colorants=SRGB_COLORANTS, space: bytes = b"RGB ") -> bytes:
    red, green, blue = curves * 3 if len(curves) == 1 else curves
    columns = (b"XYZ \0\0\0\0" + fixed(*column) for column in colorants)
    names = (b"rXYZ", b"gXYZ", b"bXYZ", b"rTRC", b"gTRC", b"bTRC")
    entries, body = b"", b""
    for name, tag in zip(names, (*columns, red, green, blue), strict=True):
        entries += name + struct.pack(">II", 128 + 4 + 12 * 6 + len(body), len(tag))
        body += tag
    return bytes(16) + space + bytes(108) + struct.pack(">I", 6) + entries + body


def test_the_profile_of_little_cms():
    transfer, primaries = colours_of_profile(PATH, ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes())
    assert transfer is SRGB
    assert primaries.agrees(SPACES["rec709"])


@pytest.mark.parametrize(
    ("curve", "name", "decode"),
    [
        (b"curv" + bytes(8), "linear", lambda v: v),
        (gamma(1.0), "linear", lambda v: v),
        (table(np.linspace(0, 1, 2)), "linear", lambda v: v),
        (gamma(1.8), "gamma 1.8", lambda v: v**1.80078125),
        (parametric(0, 2.2), "gamma 2.2", lambda v: v**2.2),
        (parametric(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045), "sRGB", SRGB.decode),
        (table(SRGB.decode(np.linspace(0, 1, 1024))), "sRGB", SRGB.decode),
        (table(np.linspace(0, 1, 256) ** 3), "its profile's curve", lambda v: v**3),
        (parametric(1, 2.0, 0.5, 0.5), "its profile's curve", lambda v: (0.5 * v + 0.5) ** 2),
        (parametric(1, 2.0, 2.0, -1.0), "its profile's curve", lambda v: np.where(v < 0.5, 0, (2 * v - 1) ** 2)),
        (parametric(2, 2.0, 0.5, 0.25, 0.1), "its profile's curve", lambda v: (0.5 * v + 0.25) ** 2 + 0.1),
        (
            parametric(4, 2.0, 1.0, 0.0, 0.25, 0.5, 0.125, 0.0),
            "its profile's curve",
            lambda v: np.where(v < 0.5, v / 4, v**2 + 0.125),
        ),
    ],
)
def test_curves(curve, name, decode):
    transfer, primaries = colours_of_profile(PATH, profile(curve))
    assert transfer.name == name
    np.testing.assert_allclose(transfer.decode(RAMP), decode(RAMP), atol=1e-4)
    assert str(primaries) == "rec709"


def test_primaries_are_those_that_the_profile_has_adapted():
    assert str(colours_of_profile(PATH, profile(gamma(1), colorants=P3_COLORANTS)).primaries) == "p3-d65"


@pytest.mark.parametrize(
    "damaged",
    [
        b"",
        profile(gamma(2.2), space=b"CMYK"),
        profile(gamma(2.2), space=b"GRAY"),
        profile(gamma(2.2), gamma(2.2), gamma(1.8)),
        profile(gamma(2.2))[:-1],
        profile(gamma(2.2))[:150],
        profile(table(np.linspace(0, 1, 16)))[:-4],
        profile(b"mAB " + bytes(40)),
        profile(parametric(7, *[1.0] * 7)),
        profile(parametric(1, 2.0, 0.0, 0.0)),
        profile(parametric(4, 2.0, 1.0)),
        profile(gamma(2.2), colorants=((0, 0, 0),) * 3),
        profile(gamma(2.2), colorants=(SRGB_COLORANTS[0],) * 3),
    ],
)
def test_profiles_that_are_no_primaries_and_a_curve(damaged):
    with pytest.raises(ValueError, match=r"^photo\.png: its colour profile \(ICC\) is not three primaries"):
        colours_of_profile(PATH, damaged)
