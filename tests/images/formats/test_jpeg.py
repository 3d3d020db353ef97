"""JPEG files: orientation, profiles, damage."""

import struct

import cv2
import numpy as np
import pytest
import torch
from PIL import Image, ImageCms, ImageFile

from picture_files import as_orientation, exif
from torchbrdf.images import open_mask, read_image, read_picture
from torchbrdf.images.encodings import SRGB
from torchbrdf.images.formats import read_stored

SMOOTH = np.stack(np.broadcast_arrays(np.arange(24)[:, None] * 9, np.arange(40) * 6, 128), axis=-1).astype("u1")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.jpg"


def save(path, pixels: np.ndarray, **options: object) -> None:
    Image.fromarray(np.ascontiguousarray(pixels)).save(path, "JPEG", quality=95, subsampling=0, **options)


@pytest.mark.parametrize("name", ["a.jpg", "a.jpeg", "A.JPG"])
def test_values_are_srgb(tmp_path, name):
    save(tmp_path / name, SMOOTH)
    read = read_picture(tmp_path / name, allow_ldr=True)
    other = cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED)[..., ::-1]
    expected = torch.from_numpy(SRGB.decode(other / 255)).permute(2, 0, 1).float()
    # Decoders may round to neighbours: a step of 8 bits, times the steepest slope of the curve.
    torch.testing.assert_close(read.image, expected, rtol=0, atol=2.3 / 255)
    assert read.about == ("8-bit JPEG decoded with sRGB",)


def test_integers_are_taken_only_where_that_is_allowed(path):
    save(path, SMOOTH)
    message = (
        r"a\.jpg: 8-bit JPEG is not linear HDR; give an \.exr or \.hdr image, merge several exposures with "
        r"`torchbrdf merge`, or pass --allow-ldr "
        r"\(allow_ldr=True in Python\) to decode it with sRGB$"
    )
    with pytest.raises(ValueError, match=message):
        read_image(path)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation(path, orientation):
    save(path, as_orientation(SMOOTH, orientation), exif=b"Exif\0\0" + exif(orientation))
    np.testing.assert_allclose(read_stored(path).values, SMOOTH.transpose(2, 0, 1) / 255, atol=4 / 255)


def test_a_profile_counts(path):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    save(path, SMOOTH, icc_profile=profile)
    assert read_picture(path, allow_ldr=True).about == ("8-bit JPEG decoded with sRGB",)
    lab = ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()
    save(path, SMOOTH, icc_profile=lab)
    with pytest.raises(ValueError, match=r"a\.jpg: its colour profile \(ICC\) is not three primaries and one curve"):
        read_image(path, allow_ldr=True)


def test_cmyk_is_named(path):
    Image.fromarray(SMOOTH).convert("CMYK").save(path)
    with pytest.raises(ValueError, match=r"a\.jpg: holds CMYK colours; export it as RGB$"):
        read_image(path, allow_ldr=True)


def test_grey_is_a_mask_alone(path):
    white = np.zeros((32, 32), "u1")
    white[8:24, 8:20] = 255
    save(path, white)
    assert abs(int(open_mask(path).marked.sum()) - 16 * 12) <= 8
    with pytest.raises(ValueError, match=r"a\.jpg: expected R, G, B channels, got one of grey$"):
        read_image(path, allow_ldr=True)


def test_no_truncated_file_is_read(path, capfd):
    save(path, SMOOTH)
    whole = path.read_bytes()
    for length in range(1, len(whole), 5):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"a\.jpg: not a readable JPEG image"):
            read_stored(path)
    assert capfd.readouterr() == ("", "")


def test_pictures_with_a_preview_behind_them(path):
    """As telephones write: several pictures in one file, of which the first is meant."""
    frames = [Image.fromarray(SMOOTH), Image.fromarray(255 - SMOOTH)]
    frames[0].save(path, "MPO", save_all=True, append_images=frames[1:], quality=95, subsampling=0)
    np.testing.assert_allclose(read_stored(path).values, SMOOTH.transpose(2, 0, 1) / 255, atol=4 / 255)


def test_more_pixels_than_the_bytes_can_hold(path, monkeypatch):
    """The size that a file claims, made 32768 x 2320: refused before memory is asked for."""
    save(path, SMOOTH)
    content = path.read_bytes()
    size = content.index(b"\xff\xc0") + 5
    path.write_bytes(content[:size] + struct.pack(">HH", 32768, 2320) + content[size + 4 :])
    monkeypatch.setattr(ImageFile.ImageFile, "load", lambda image: pytest.fail("decoded"))
    with pytest.raises(ValueError, match=r"a\.jpg: not a readable JPEG image \(truncated"):
        read_image(path, allow_ldr=True)


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_what_compresses_best_is_read(path, mode, progressive):
    Image.new(mode, (2048, 2048)).save(path, "JPEG", progressive=progressive, optimize=True)
    assert read_stored(path).values.shape == (len(mode), 2048, 2048)


def test_an_exif_block_that_is_cut_says_nothing(path):
    save(path, SMOOTH, exif=b"Exif\0\0MM\0*\0\0")
    cut = read_image(path, allow_ldr=True)
    save(path, SMOOTH)
    assert torch.equal(cut, read_image(path, allow_ldr=True))
