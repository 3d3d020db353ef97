"""Colour spaces that OpenEXR files name by a word, without chromaticities."""

import re
import warnings

import pytest
import torch

from picture_files import picture, rgb, write_exr
from torchbrdf.images import read_image, read_picture
from torchbrdf.images.primaries import SPACES, converted

VALUES = picture(3, 4)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.exr"


@pytest.mark.parametrize(
    ("key", "name", "space"),
    [
        ("colorInteropID", "lin_rec709_scene", "rec709"),
        ("colorInteropID", "lin_rec2020_scene", "rec2020"),
        ("colorInteropID", "lin_p3d65_scene", "p3-d65"),
        ("colorInteropID", "lin_ap0_scene", "aces-ap0"),
        ("colorInteropID", "lin_ap1_scene", "aces-ap1"),
        ("oiio:ColorSpace", "ACEScg", "aces-ap1"),
        ("oiio:ColorSpace", "ACES2065-1", "aces-ap0"),
        ("oiio:ColorSpace", "lin_rec709", "rec709"),
        ("oiio:ColorSpace", "lin_srgb", "rec709"),
        ("colorspace", "ACES - ACEScg", "aces-ap1"),
        ("colorspace", "ACES - ACES2065-1", "aces-ap0"),
        ("colorspace", "Utility - Linear - Rec.2020", "rec2020"),
        ("colorspace", "Linear Rec.709 (sRGB)", "rec709"),
        ("colorspace", "Linear P3-D65", "p3-d65"),
    ],
)
def test_linear_spaces_are_converted(path, key, name, space):
    write_exr(path, rgb(VALUES.numpy()), **{key: name})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = read_picture(path)
        kept = read_image(path, primaries=space)
    torch.testing.assert_close(read.image, converted(VALUES, space, "rec709"), rtol=1e-5, atol=1e-4)
    assert torch.equal(kept, VALUES)
    assert read.about[:1] == (() if space == "rec709" else (f"{space} to rec709",))


@pytest.mark.parametrize("name", ["", "linear", "Linear", "scene_linear", "role_scene_linear", "raw", "data"])
def test_names_that_say_nothing(path, name):
    write_exr(path, rgb(VALUES.numpy()), **{"oiio:ColorSpace": name})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert torch.equal(read_image(path), VALUES)


@pytest.mark.parametrize(
    ("key", "name"),
    [
        ("colorInteropID", "srgb_rec709_scene"),
        ("colorInteropID", "lin_ciexyzd65_scene"),
        ("oiio:ColorSpace", "sRGB"),
        ("oiio:ColorSpace", "ACEScct"),
        ("colorspace", "Gamma2.2"),
    ],
)
def test_other_names_are_warned_of(path, key, name):
    write_exr(path, rgb(VALUES.numpy()), **{key: name})
    expected = f"{path}: says that its colours are '{name}' ({key}), no linear space that is known here; taken as "
    with pytest.warns(UserWarning, match=f"^{re.escape(expected)}linear Rec. 709: where they are not, convert"):
        read = read_picture(path)
    assert torch.equal(read.image, VALUES)
    assert read.about == ()


def test_chromaticities_count_whatever_the_name_is(path):
    numbers = sum(SPACES["aces-ap0"].values, ())
    write_exr(path, rgb(VALUES.numpy()), chromaticities=numbers, colorInteropID="lin_rec2020_scene", colorspace="sRGB")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_picture(path).about[0] == "aces-ap0 to rec709"


def test_the_first_name_that_says_something_counts(path):
    names = {"colorInteropID": "unknown", "oiio:ColorSpace": "ACEScg", "colorspace": "sRGB"}
    write_exr(path, rgb(VALUES.numpy()), **names)
    assert read_picture(path).about[0] == "aces-ap1 to rec709"


def test_numbers_are_no_names(path):
    write_exr(path, rgb(VALUES.numpy()), colorspace=1.0)
    assert torch.equal(read_image(path), VALUES)
