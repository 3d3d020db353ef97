"""PNG files: depths, palettes, transparency, and what their chunks say of colours."""

import struct
import zlib

import cv2
import numpy as np
import pytest
import torch
from PIL import Image, ImageCms

from picture_files import as_orientation, chunk, exif, png, png_of
from torchbrdf.images import open_mask, read_image, read_picture
from torchbrdf.images.encodings import SRGB
from torchbrdf.images.formats import read_stored

RAMP = np.arange(0, 60, dtype="u1").reshape(4, 5, 3) * 4
REC709 = (31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000)
REC2020 = (31270, 32900, 70800, 29200, 17000, 79700, 13100, 4600)


def iccp(profile: bytes) -> bytes:
    return chunk(b"iCCP", b"a profile\0\0" + zlib.compress(profile))


def srgb_profile() -> bytes:
    return ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()


def chrm(numbers: tuple[int, ...]) -> bytes:
    return chunk(b"cHRM", struct.pack(">8I", *numbers))


GAMA_LINEAR, GAMA_22 = (chunk(b"gAMA", struct.pack(">I", number)) for number in (100000, 45455))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.png"


def decoded(values: np.ndarray, name: str) -> torch.Tensor:
    curves = {"linear": lambda v: v, "gamma 2.2": lambda v: v**2.2, "sRGB": SRGB.decode}
    return torch.from_numpy(curves[name](values).astype("f4")).permute(2, 0, 1)


@pytest.mark.parametrize("dtype", ["u1", "u2"])
def test_depths(path, dtype):
    pixels = (RAMP.astype(dtype) * (257 if dtype == "u2" else 1)).astype(dtype)
    path.write_bytes(png_of(pixels, GAMA_LINEAR))
    expected = torch.from_numpy(RAMP / np.float32(255)).permute(2, 0, 1)
    torch.testing.assert_close(read_image(path, allow_ldr=True), expected, rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    ("rows", "width", "depth", "expected"),
    [
        ([b"\xa0"], 4, 1, [1, 0, 1, 0]),
        ([b"\x1b"], 4, 2, [0, 1 / 3, 2 / 3, 1]),
        ([b"\x0f\x80"], 3, 4, [0, 1, 8 / 15]),
    ],
)
def test_grey_of_few_bits(path, rows, width, depth, expected):
    path.write_bytes(png(rows, width, depth, kind=0))
    np.testing.assert_allclose(read_stored(path).values[0, 0], expected, atol=1e-6)


def test_palette(path):
    colours = np.array([[0, 0, 0], [255, 0, 0], [0, 128, 255], [9, 8, 7]], "u1")
    path.write_bytes(png([b"\x1b"], 4, 2, 3, chunk(b"PLTE", colours.tobytes())))
    assert np.array_equal(read_stored(path).values[:, 0].T, colours / np.float32(255))
    path.write_bytes(png([b"\x1b"], 4, 2, 3, chunk(b"PLTE", colours.tobytes()) + chunk(b"tRNS", b"\0\x80")))
    stored = read_stored(path)
    assert np.array_equal(stored.values[:, 0].T, colours / np.float32(255))
    np.testing.assert_allclose(stored.alpha[0], [0, 128 / 255, 1, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("pixels", "transparent"),
    [
        (np.array([[0, 7, 255]], "u1"), b"\0\7"),
        (np.array([[[1, 2, 3], [7, 7, 7], [3, 2, 1]]], "u1"), b"\0\7\0\7\0\7"),
        (np.array([[[1, 2, 3], [700, 700, 7], [3, 2, 1]]], "u2"), b"\2\xbc\2\xbc\0\7"),
    ],
)
def test_one_transparent_colour(path, pixels, transparent):
    path.write_bytes(png_of(pixels, chunk(b"tRNS", transparent)))
    assert read_stored(path).alpha.tolist() == [[1, 0, 1]]


@pytest.mark.parametrize("channels", [2, 4])
@pytest.mark.parametrize("dtype", ["u1", "u2"])
def test_alpha(path, channels, dtype):
    pixels = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (5, 6, channels)).astype(dtype)
    path.write_bytes(png_of(pixels))
    stored = read_stored(path)
    assert len(stored.values) == channels - 1
    np.testing.assert_allclose(stored.alpha, pixels[..., -1] / np.iinfo(dtype).max, atol=1e-7)
    np.testing.assert_allclose(stored.values, pixels[..., :-1].transpose(2, 0, 1) / np.iinfo(dtype).max, atol=1e-7)


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "L", "LA", "P", "1"])
def test_values_are_those_of_another_reader(path, mode):
    colours = Image.fromarray(np.random.default_rng(0).integers(0, 256, (23, 31, 4)).astype("u1"))
    colours.convert("RGB").convert(mode).save(path)
    other = np.atleast_3d(np.asarray(Image.open(path).convert("RGB" if mode in "P1" else mode)))
    stored = read_stored(path)
    planes = stored.values if stored.alpha is None else np.concatenate([stored.values, stored.alpha[None]])
    if mode == "1":
        planes = np.repeat(planes, 3, axis=0)
    assert np.array_equal((planes * 255).round().astype("u1"), other.transpose(2, 0, 1))


def test_sixteen_bits_are_those_of_another_reader(path):
    pixels = np.random.default_rng(0).integers(0, 65536, (23, 31, 3)).astype("u2")
    cv2.imwrite(str(path), pixels)
    assert np.array_equal((read_stored(path).values * 65535).round(), pixels[..., ::-1].transpose(2, 0, 1))


@pytest.mark.parametrize(
    ("chunks", "name", "primaries"),
    [
        (b"", "gamma 2.2", None),
        (GAMA_LINEAR, "linear", None),
        (GAMA_22, "gamma 2.2", None),
        (chunk(b"gAMA", bytes(4)), "gamma 2.2", None),
        (chunk(b"sRGB", b"\0"), "sRGB", "rec709"),
        (chunk(b"sRGB", b"\0") + GAMA_22 + chrm(REC2020), "sRGB", "rec709"),
        (GAMA_LINEAR + chrm(REC2020), "linear", "rec2020"),
        (GAMA_LINEAR + chrm(REC709), "linear", "rec709"),
        (chunk(b"cICP", bytes((1, 13, 0, 1))), "sRGB", "rec709"),
        (chunk(b"cICP", bytes((12, 8, 0, 1))) + GAMA_22, "linear", "p3-d65"),
        (chunk(b"cICP", bytes((9, 8, 0, 1))) + chunk(b"sRGB", b"\0"), "linear", "rec2020"),
        (iccp(srgb_profile()), "sRGB", "rec709"),
        (iccp(srgb_profile()) + GAMA_LINEAR, "sRGB", "rec709"),
    ],
)
def test_what_the_file_says_of_colours(path, chunks, name, primaries):
    path.write_bytes(png_of(RAMP, chunks))
    transfer, space = read_stored(path).colours()
    assert (None if space is None else str(space)) == primaries
    assert getattr(transfer, "name", "gamma 2.2") == name
    read = read_picture(path, allow_ldr=True, primaries=primaries or "rec709")
    torch.testing.assert_close(read.image, decoded(RAMP / 255, name), rtol=0, atol=2e-5)
    assert read.about == (f"8-bit PNG decoded with {name}",)


def test_primaries_are_converted(path):
    path.write_bytes(png_of(RAMP, GAMA_LINEAR + chrm(REC2020)))
    whole = read_image(path, allow_ldr=True, primaries="rec2020")
    expected = torch.einsum("ij,jhw->ihw", torch.tensor([[1.6605, -0.5876, -0.0728]]), whole)
    torch.testing.assert_close(read_image(path, allow_ldr=True)[:1], expected, rtol=0, atol=1e-3)


@pytest.mark.parametrize(
    "coded", [(9, 16, 0, 1), (9, 18, 0, 1), (1, 1, 0, 1), (1, 13, 1, 1), (1, 13, 0, 0), (2, 13, 0, 1)]
)
def test_codes_that_are_not_read(path, coded):
    path.write_bytes(png_of(RAMP, chunk(b"cICP", bytes(coded))))
    with pytest.raises(ValueError, match=rf"a\.png: its cICP chunk \({bytes(coded).hex(' ')}\) names an encoding"):
        read_image(path, allow_ldr=True)


@pytest.mark.parametrize(
    ("chunks", "message"),
    [
        (chunk(b"iCCP", b"a profile\0\0damage"), r"its colour profile \(chunk iCCP\) is damaged; export it again$"),
        (iccp(b"short"), r"its colour profile \(ICC\) is not three primaries and one curve; export it as sRGB"),
        (chrm((0,) * 8), "chunk cHRM: chromaticities must be finite"),
    ],
)
def test_colours_that_are_not_understood_matter_to_photographs_alone(path, chunks, message):
    white = np.zeros((6, 6, 3), "u1")
    white[2:4, 2:5] = 255
    path.write_bytes(png_of(white, chunks))
    with pytest.raises(ValueError, match=message):
        read_image(path, allow_ldr=True)
    assert open_mask(path).marked.sum() == 6


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation(path, orientation):
    path.write_bytes(png_of(as_orientation(RAMP, orientation), GAMA_LINEAR + chunk(b"eXIf", exif(orientation))))
    np.testing.assert_allclose(read_image(path, allow_ldr=True), RAMP.transpose(2, 0, 1) / 255, atol=1e-6)


@pytest.mark.parametrize("block", [b"", b"MM", b"MM\0*\0\0", exif(0), exif(9), b"\xff" * 40, exif(6)[:20]])
def test_orientations_that_say_nothing(path, block):
    path.write_bytes(png_of(RAMP, GAMA_LINEAR + chunk(b"eXIf", block)))
    np.testing.assert_allclose(read_image(path, allow_ldr=True), RAMP.transpose(2, 0, 1) / 255, atol=1e-6)


def test_alpha_is_turned_with_the_colours(path):
    pixels = np.random.default_rng(0).integers(0, 255, (4, 5, 4)).astype("u1")
    path.write_bytes(png_of(as_orientation(pixels, 6), chunk(b"eXIf", exif(6))))
    np.testing.assert_allclose(read_stored(path).alpha, pixels[..., 3] / 255, atol=1e-6)


@pytest.mark.parametrize("orientation", range(2, 9))
def test_turned_alpha_is_read_with_the_picture(path, orientation):
    pixels = np.random.default_rng(0).integers(0, 255, (4, 5, 4)).astype("u1")
    path.write_bytes(png_of(as_orientation(pixels, orientation), chunk(b"eXIf", exif(orientation))))
    np.testing.assert_allclose(read_picture(path, True).alpha[0], pixels[..., 3] / 255, atol=1e-6)


def test_interlaced(path):
    """The passes of Adam7, by their definition: offsets and steps."""
    steps = [(0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1)]
    pixels = np.random.default_rng(0).integers(0, 255, (11, 13, 3)).astype("u1")
    passes = (pixels[row::down, column::right] for row, column, down, right in steps)
    raw = b"".join(b"\0" + line.tobytes() for part in passes for line in part if part.size)
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 13, 11, 8, 2, 0, 0, 1))
    body = chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + header + body)
    assert np.array_equal(np.asarray(Image.open(path)), pixels)
    np.testing.assert_allclose(read_stored(path).values, pixels.transpose(2, 0, 1) / 255, atol=1e-6)


def test_no_truncated_and_no_damaged_file_is_read_wrong(path, capfd):
    whole = png_of(RAMP, GAMA_LINEAR)
    path.write_bytes(whole)
    right = read_stored(path).values
    for length in range(1, len(whole)):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"a\.png: not a readable PNG image"):
            read_stored(path)
    for place in range(8, len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 4]) + whole[place + 1 :])
        try:
            read = read_stored(path).values
        except ValueError:
            continue
        assert np.array_equal(read, right)
    assert capfd.readouterr() == ("", "")


def test_a_header_that_asks_for_terabytes_is_refused(path):
    huge = png_of(RAMP).replace(struct.pack(">II", 5, 4), struct.pack(">II", 900_000, 900_000))
    path.write_bytes(huge)
    with pytest.raises(ValueError, match=r"a\.png: not a readable PNG image"):
        read_image(path, allow_ldr=True)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_one_pixel_may_be_turned(path, orientation):
    pixels = np.full((1, 1, 4), 128, "u1")
    path.write_bytes(png_of(pixels, chunk(b"eXIf", exif(orientation))))
    assert read_image(path, allow_ldr=True).shape == (3, 1, 1)
