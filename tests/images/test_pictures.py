"""Linear pictures: what is read as integers, in which space, and what is said of it."""

import re

import cv2
import numpy as np
import pytest
import torch

from picture_files import chunk, picture, png_of, rgb, write_exr
from torchbrdf.images import read_image, read_metadata, read_picture, write_image
from torchbrdf.images.primaries import SPACES, conversion

RAMP = np.arange(60, dtype="u1").reshape(4, 5, 3) * 4


def tensor(pixels: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(pixels.astype("f4")).permute(2, 0, 1)


def test_integers_are_read_only_when_allowed_and_decoded(tmp_path):
    path = tmp_path / "photo.png"
    image = picture() / 100
    write_image(path, image)
    message = (
        f"{path}: 8-bit PNG is not linear HDR; give an .exr or .hdr image, "
        "merge several exposures with `torchbrdf merge`, or pass --allow-ldr (allow_ldr=True in Python) to "
        "decode it with gamma 2.2"
    )
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        read_image(path)
    # Half a step of 8 bits, times the steepest slope of x^2.2.
    assert (read_image(path, allow_ldr=True) - image).abs().max() < 2.2 / 255 / 2 * 1.01


def test_where_integers_cannot_be_allowed_the_option_is_said_to_be_of_no_use(tmp_path):
    write_image(tmp_path / "probe.png", picture())
    message = r"probe\.png: 8-bit PNG is not linear HDR; give an \.exr or \.hdr image; --allow-ldr is for photographs"
    with pytest.raises(ValueError, match=message):
        read_picture(tmp_path / "probe.png", allow_ldr=None)


def test_integers_of_16_bits_with_alpha(tmp_path):
    pixels = np.zeros((2, 3, 4), "u2")
    pixels[..., :3] = [65535, 32768, 0]  # B, G, R
    cv2.imwrite(str(tmp_path / "deep.png"), pixels)
    read = read_picture(tmp_path / "deep.png", allow_ldr=True)
    torch.testing.assert_close(read.image[:, 1, 1], torch.tensor([0.0, 0.217645, 1.0]), atol=1e-5, rtol=0)
    assert read.alpha is None
    assert read.about == ("16-bit PNG decoded with gamma 2.2",)


@pytest.mark.parametrize(
    ("encoding", "decode", "name"),
    [
        ("linear", lambda v: v, "linear"),
        ("gamma2.2", lambda v: v**2.2, "gamma 2.2"),
        ("srgb", lambda v: np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4), "sRGB"),
    ],
)
@pytest.mark.parametrize("says", [b"", chunk(b"sRGB", b"\0"), chunk(b"gAMA", (100000).to_bytes(4, "big"))])
def test_an_encoding_counts_whatever_the_file_says(tmp_path, encoding, decode, name, says):
    (tmp_path / "a.png").write_bytes(png_of(RAMP, says))
    read = read_picture(tmp_path / "a.png", encoding=encoding)
    torch.testing.assert_close(read.image, tensor(decode(RAMP / 255)), rtol=0, atol=1e-6)
    assert read.about == (f"8-bit PNG decoded with {name}",)


def test_encodings_that_are_none(tmp_path):
    write_image(tmp_path / "a.exr", picture())
    assert torch.equal(read_image(tmp_path / "a.exr", encoding="linear"), picture())
    with pytest.raises(ValueError, match=r"a\.exr: its values are floating-point and taken as linear; leave"):
        read_image(tmp_path / "a.exr", encoding="srgb")
    with pytest.raises(ValueError, match=r"^encoding must be one of linear, srgb, gamma2\.2, got 'gamma'$"):
        read_image(tmp_path / "a.exr", encoding="gamma")


@pytest.mark.parametrize("target", SPACES)
@pytest.mark.parametrize("source", [None, *SPACES])
def test_the_space_of_the_result(tmp_path, source, target):
    values = picture(3, 4).numpy()
    header = {} if source is None else {"chromaticities": sum(SPACES[source].values, ())}
    write_exr(tmp_path / "a.exr", rgb(values), **header)
    read = read_picture(tmp_path / "a.exr", primaries=target)
    source = source or "rec709"
    if source == target:
        assert np.array_equal(read.image, values)
        assert read.about == ()
        return
    expected = np.einsum("ij,jhw->ihw", conversion(SPACES[source], SPACES[target]), values)
    np.testing.assert_allclose(read.image, expected, rtol=1e-4, atol=1e-3)
    assert read.about[0] == f"{source} to {target}"


def test_colours_outside_the_space_are_counted(tmp_path):
    values = np.ones((3, 2, 3), "f4")
    values[:, 0, 0] = [0, 1, 0]
    values[:, 1, 2] = [1, 0, 0]
    values[:, 1, 1] = [-1, 1, 1]  # outside of its own space already
    values[0, 0, 1] = np.nan
    write_exr(tmp_path / "a.exr", rgb(values), chromaticities=sum(SPACES["rec2020"].values, ()))
    said = "2 of its 6 pixels have colours outside rec709, negative there"
    assert read_picture(tmp_path / "a.exr").about == ("rec2020 to rec709", said)


def test_values_that_are_no_numbers_pass_through_a_conversion(tmp_path):
    values = np.ones((3, 2, 2), "f4")
    values[:, 0, 0] = [np.inf, 1, 2]
    values[:, 1, 1] = np.nan
    write_exr(tmp_path / "a.exr", rgb(values), chromaticities=sum(SPACES["aces-ap1"].values, ()))
    read = read_image(tmp_path / "a.exr")
    assert read[:, 0, 0].tolist() == [np.inf, 1, 2]
    assert read[:, 1, 1].isnan().all()
    torch.testing.assert_close(read[:, 0, 1], torch.ones(3))


def test_spaces_that_are_none(tmp_path):
    write_image(tmp_path / "a.exr", picture())
    message = r"^primaries must be one of rec709, rec2020, p3-d65, aces-ap0, aces-ap1, xyz, got 'srgb'$"
    with pytest.raises(ValueError, match=message):
        read_image(tmp_path / "a.exr", primaries="srgb")


def test_grey_is_no_photograph(tmp_path):
    (tmp_path / "grey.png").write_bytes(png_of(RAMP[..., 0]))
    with pytest.raises(ValueError, match=r"grey\.png: expected R, G, B channels, got one of grey$"):
        read_image(tmp_path / "grey.png", allow_ldr=True)


def test_metadata_of_other_programs_is_text_only(tmp_path):
    write_exr(tmp_path / "a.exr", rgb(np.zeros((3, 2, 2), "f4")), owner="someone", expTime=0.25, name="part")
    assert read_metadata(tmp_path / "a.exr") == {"owner": "someone"}


def test_metadata_of_bad_files(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.exr: no such file; expected an OpenEXR image$"):
        read_metadata(tmp_path / "nothing.exr")
    (tmp_path / "bad.exr").write_bytes(b"hello")
    with pytest.raises(ValueError, match=r"bad\.exr: not a readable OpenEXR image"):
        read_metadata(tmp_path / "bad.exr")
    write_image(tmp_path / "a.hdr", picture())
    with pytest.raises(ValueError, match=r"a\.hdr: image suffix '\.hdr' is not supported; use \.exr$"):
        read_metadata(tmp_path / "a.hdr")
