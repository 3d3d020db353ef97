"""Radiance .hdr and .pic, against scanlines that the tests encode themselves."""

import itertools
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st

from picture_files import picture
from torchbrdf.images import open_mask, read_image, read_picture, write_image
from torchbrdf.images.formats import read_stored
from torchbrdf.images.primaries import SPACES, Primaries, conversion

LABELS = np.full((2, 3, 4), 136, "u1")
LABELS[..., 0] = [[10, 20, 30], [40, 50, 60]]
LABELS[..., 1:3] = [7, 200]
"""RGBE; the exponent of 136 makes each value equal its mantissa."""


def flat(line: np.ndarray) -> bytes:
    return line.tobytes()


def by_pixel(line: np.ndarray) -> bytes:
    """The old run lengths: (1, 1, 1, n) repeats, in digits of 256 from the lowest."""
    stored = b""
    for pixel, run in itertools.groupby(map(bytes, line)):
        stored += pixel
        more = len(list(run)) - 1
        while more:
            stored += bytes((1, 1, 1, more & 255))
            more >>= 8
    return stored


def by_component(line: np.ndarray) -> bytes:
    """The new run lengths."""
    stored = bytes((2, 2, len(line) >> 8, len(line) & 255))
    for component in line.T:
        for value, run in itertools.groupby(component.tolist()):
            length = len(list(run))
            while length:
                part = min(length, 127)
                stored += bytes((128 + part, value)) if part > 1 else bytes((1, value))
                length -= part
    return stored


def literal(line: np.ndarray) -> bytes:
    """The new way without a run, in the longest pieces."""
    stored = bytes((2, 2, len(line) >> 8, len(line) & 255))
    for component in line.T:
        pieces = [component[i : i + 128] for i in range(0, len(component), 128)]
        stored += b"".join(bytes([len(piece)]) + piece.tobytes() for piece in pieces)
    return stored


def hdr(lines: np.ndarray, *header: str, store=flat, axes: str = "-Y {} +X {}", signature: str = "#?RADIANCE") -> bytes:
    """A file of scanlines (count, length, 4)."""
    text = "\n".join([*filter(None, [signature]), *header, "FORMAT=32-bit_rle_rgbe", "", axes.format(*lines.shape[:2])])
    return text.encode() + b"\n" + b"".join(map(store, lines))


def values_of(rgbe: np.ndarray) -> torch.Tensor:
    exponents = rgbe[..., 3:].astype(float)
    values = np.where(exponents > 0, rgbe[..., :3] * 2.0 ** (exponents - 136), 0)
    return torch.from_numpy(values.astype("f4").transpose(2, 0, 1))


def random_rgbe(height: int, width: int, seed: int = 0) -> np.ndarray:
    """Few values, so that there are runs; no pixel that either way of run lengths takes for its own."""
    return np.random.default_rng(seed).choice(np.array([3, 100, 255], "u1"), (height, width, 4))


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "a.hdr"


@pytest.mark.parametrize("first", ["-Y", "+Y", "-X", "+X"])
@pytest.mark.parametrize("second", ["+", "-"])
@pytest.mark.parametrize("store", [flat, by_pixel])
def test_all_eight_orientations(path, first, second, store):
    """Radiance counts x from the left and y from the bottom; a sign says which way scanlines and pixels run."""
    second += "X" if first[1] == "Y" else "Y"
    height, width, _ = LABELS.shape
    count, length = (height, width) if first[1] == "Y" else (width, height)
    stored = np.zeros((count, length, 4), "u1")
    for i, j in np.ndindex(count, length):
        along = {first[1]: i if first[0] == "+" else count - 1 - i}
        along[second[1]] = j if second[0] == "+" else length - 1 - j
        stored[i, j] = LABELS[height - 1 - along["Y"], along["X"]]
    path.write_bytes(hdr(stored, store=store, axes=f"{first} {{}} {second} {{}}"))
    assert torch.equal(read_image(path), values_of(LABELS))


@pytest.mark.parametrize("width", [1, 7, 8, 127, 128, 129, 32767, 32768])
def test_widths_around_the_bounds_of_each_way_to_store(path, width):
    rgbe = random_rgbe(1, width)
    for store in [flat, by_pixel, *([by_component, literal] if 8 <= width < 32768 else [])]:
        path.write_bytes(hdr(rgbe, store=store))
        assert torch.equal(read_image(path), values_of(rgbe)), store.__name__


def test_scanlines_stored_in_different_ways(path):
    rgbe = random_rgbe(4, 20)
    begin = hdr(rgbe[:0]).replace(b"-Y 0", b"-Y 4")
    pixels = b"".join(store(line) for store, line in zip((literal, flat, by_pixel, by_component), rgbe, strict=True))
    path.write_bytes(begin + pixels)
    assert torch.equal(read_image(path), values_of(rgbe))


def test_repeat_counts_of_several_digits(path):
    rgbe = np.tile(np.array([9, 8, 7, 130], "u1"), (2, 70_000, 1))
    rgbe[1, -3:] = [1, 2, 3, 4]
    path.write_bytes(hdr(rgbe, store=by_pixel))
    assert path.stat().st_size < 200
    assert torch.equal(read_image(path), values_of(rgbe))


def test_all_exponents(path):
    rgbe = np.zeros((1, 256, 4), "u1")
    rgbe[..., :3] = [255, 128, 3]
    rgbe[..., 3] = np.arange(256)
    path.write_bytes(hdr(rgbe))
    read = read_image(path)
    assert torch.equal(read, values_of(rgbe))
    assert read[:, 0, 0].tolist() == [0, 0, 0]
    assert torch.isfinite(read).all()


@given(seed=st.integers(0, 10**6), width=st.integers(8, 40), scale=st.floats(-30, 30))
@settings(deadline=None, max_examples=25)
def test_values_are_those_of_another_reader(tmp_path_factory, seed, width, scale):
    path = tmp_path_factory.mktemp("hdr") / "a.hdr"
    written = np.random.default_rng(seed).choice([0, 0.1, 1.0, 7.3], (3, width, 3)) * 2**scale
    cv2.imwrite(str(path), written.astype("f4"))
    other = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1]
    assert np.array_equal(read_image(path).permute(1, 2, 0).numpy(), other)


@pytest.mark.parametrize("length", [127, 128, 254, 255, 256, 300, 5000])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_long_lines_and_ends_of_lines(path, length, end):
    head, pixels = hdr(LABELS, "# " + "x" * (length - 2)).split(b"+X 3\n", 1)
    path.write_bytes((head + b"+X 3\n").replace(b"\n", end.encode()) + pixels)
    assert torch.equal(read_image(path), values_of(LABELS))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"#?RADIANCE\n", b""),
        (b"#?RADIANCE", b"#?RGBE"),
        (b"FORMAT=32-bit_rle_rgbe\n", b""),
        (b"FORMAT=32-bit_rle_rgbe\n", b"FORMAT = 32-bit_rle_rgbe \n"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n", b""),
        (b"#?RADIANCE\n", b"#?RADIANCE\nrpict -vp 1 2 3 scene.oct\nSOFTWARE= a=b\nVIEW= -vtv\n\xe4=\xff\n"),
        (b"-Y 2 +X 3", b"-Y   2   +X 3 "),
    ],
)
def test_headers_that_are_in_order(path, old, new):
    whole = hdr(LABELS)
    assert old in whole
    path.write_bytes(whole.replace(old, new))
    assert torch.equal(read_image(path), values_of(LABELS))


def test_the_suffix_of_radiance_itself(tmp_path):
    (tmp_path / "A.PIC").write_bytes(hdr(LABELS))
    assert torch.equal(read_image(tmp_path / "A.PIC"), values_of(LABELS))


@pytest.mark.parametrize(
    ("lines", "over"),
    [
        (["EXPOSURE=4.0"], [4, 4, 4]),
        (["EXPOSURE=   4"], [4, 4, 4]),
        (["EXPOSURE=\t2e0 by pfilt"], [2, 2, 2]),
        (["EXPOSURE=4", "SOFTWARE=x", "EXPOSURE=0.5"], [2, 2, 2]),
        (["EXPOSURE=0"], [1, 1, 1]),
        (["EXPOSURE=0", "EXPOSURE=8"], [8, 8, 8]),
        (["COLORCORR=1 2 4"], [1, 2, 4]),
        (["COLORCORR= 1 2 4", "EXPOSURE=2", "COLORCORR=2 1 0"], [4, 4, 8]),
        (["\tEXPOSURE=4", " EXPOSURE=2"], [1, 1, 1]),  # of pictures that this one was made from
        (["# EXPOSURE=4", "pfilt EXPOSURE=4", "exposure=4", "EXPOSURES=4"], [1, 1, 1]),
    ],
)
def test_values_are_over_exposure_and_colour_correction(path, lines, over):
    path.write_bytes(hdr(LABELS, *lines))
    assert torch.equal(read_image(path), values_of(LABELS) / torch.tensor(over, dtype=torch.float32)[:, None, None])


def test_it_is_said_that_values_were_divided(path):
    path.write_bytes(hdr(LABELS, "EXPOSURE=4", "EXPOSURE=.5"))
    assert read_picture(path).about == ("values over EXPOSURE and COLORCORR, 2",)
    path.write_bytes(hdr(LABELS, "EXPOSURE=1", "COLORCORR=2 1 .5"))
    assert read_picture(path).about == ("values over EXPOSURE and COLORCORR, 2 1 0.5",)
    path.write_bytes(hdr(LABELS, "EXPOSURE=1"))
    assert read_picture(path).about == ()


@pytest.mark.parametrize("value", ["-1", "nan", "inf", "4,5", "", "x", "- 4", "0x10"])
def test_exposures_that_are_no_factors(path, value):
    path.write_bytes(hdr(LABELS, f"EXPOSURE={value}"))
    with pytest.raises(ValueError, match=rf"a\.hdr: EXPOSURE={value} in its header must be 1 numbers; mend that line$"):
        read_image(path)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["COLORCORR=1 2"], "COLORCORR=1 2 in its header must be 3 numbers"),
        (["PRIMARIES=1 0 0 \0\b0 \x7f"], r"PRIMARIES=1 0 0 \\x00\\x080 \\x7f in its header must be 8 numbers"),
        (["PRIMARIES=.64 .33 .3 .6 .15 .06 .31"], r"PRIMARIES=.* must be 8 numbers"),
        (["PRIMARIES=.64 .33 .64 .33 .15 .06 .3127 .329"], "PRIMARIES: these primaries span no colour space"),
        (["EXPOSURE=1e200", "EXPOSURE=1e200"], "EXPOSURE and COLORCORR multiply to inf: no radiance; mend its header"),
        (["EXPOSURE=1e-200", "EXPOSURE=1e-200"], "EXPOSURE and COLORCORR multiply to 0: no radiance"),
        (["EXPOSURE=1e-300"], "EXPOSURE and COLORCORR multiply to 1e-300: no radiance"),
    ],
)
def test_header_lines_that_cannot_be_meant(path, lines, message):
    path.write_bytes(hdr(LABELS, *lines))
    with pytest.raises(ValueError, match=message):
        read_image(path)


def test_primaries_are_converted(path):
    own = Primaries((0.64, 0.33), (0.29, 0.60), (0.15, 0.06), (0.333, 0.333))
    path.write_bytes(hdr(LABELS, "PRIMARIES= 0.64 0.33 0.29 0.60 0.15 0.06 0.333 0.333"))
    matrix = torch.from_numpy(conversion(own, SPACES["rec709"])).float()
    expected = torch.einsum("ij,jhw->ihw", matrix, values_of(LABELS))
    read = read_picture(path)
    torch.testing.assert_close(read.image, expected, rtol=1e-5, atol=1e-4)
    assert not torch.allclose(read.image, values_of(LABELS), rtol=1e-2)
    assert read.about == ("primaries (0.64 0.33), (0.29 0.6), (0.15 0.06), (0.333 0.333) to rec709",)


def test_the_last_primaries_count_and_those_of_rec_709_change_nothing(path):
    lines = "PRIMARIES=.7 .3 .2 .7 .15 .06 .33 .33", "PRIMARIES=.64 .33 .3 .6 .15 .06 .3127 .329"
    path.write_bytes(hdr(LABELS, *lines))
    assert torch.equal(read_image(path), values_of(LABELS))


@pytest.mark.parametrize("lines", [["PIXASPECT=1"], ["PIXASPECT=1.0004"], ["PIXASPECT=2", "PIXASPECT=0.5"]])
def test_square_pixels(path, lines):
    path.write_bytes(hdr(LABELS, *lines))
    assert torch.equal(read_image(path), values_of(LABELS))


@pytest.mark.parametrize("lines", [["PIXASPECT=2"], ["PIXASPECT=.67"], ["PIXASPECT=1.5", "PIXASPECT=1.5"]])
def test_pixels_that_are_not_square(path, lines):
    path.write_bytes(hdr(LABELS, *lines))
    with pytest.raises(ValueError, match=r"a\.hdr: pixels are not square \(pixel aspect ratio [\d.]+\)"):
        read_image(path)


def test_other_pixel_formats(path):
    path.write_bytes(hdr(LABELS).replace(b"rgbe", b"xyze"))
    with pytest.raises(ValueError, match=r"a\.hdr: its pixel format is '32-bit_rle_xyze', CIE XYZ without a white"):
        read_image(path)
    path.write_bytes(hdr(LABELS).replace(b"32-bit_rle_rgbe", b"Radiance_spectra"))
    with pytest.raises(ValueError, match=r"its pixel format is 'Radiance_spectra', not RGB; convert it$"):
        read_image(path)


@pytest.mark.parametrize("store", [flat, by_pixel, by_component, literal])
def test_no_truncated_file_is_read(path, store):
    whole = hdr(random_rgbe(2, 9), store=store)
    path.write_bytes(whole)
    read_image(path)
    for length in range(1, len(whole)):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"a\.hdr: not a readable Radiance \.hdr image"):
            read_stored(path)


@pytest.mark.parametrize(
    ("head", "pixels"),
    [
        (b"-Y 1 +X 9", b"\2\2\0\x0a" + b"\x89\5" * 4),  # says that it is of another width
        (b"-Y 1 +X 9", b"\2\2\0\x09" + b"\x8a\5" + b"\x89\5" * 3),  # a run goes on beyond the scanline
        (b"-Y 1 +X 9", b"\2\2\0\x09" + b"\0" * 60),  # pieces of no length
        (b"-Y 1 +X 3", b"\1\1\1\2" + b"\5" * 40),  # repeats a pixel before the first
        (b"-Y 1 +X 3", b"\5\5\5\5" + b"\1\1\1\4" + b"\5" * 40),  # repeats beyond the scanline
        (b"-Y 1 +X 3", b"\5\5\5\5" + b"\1\1\1\0" * 8 + b"\1\1\1\1" + b"\5" * 40),
        (b"-Y 2 +Y 3", b"\5" * 60),
        (b"-Y 2", b"\5" * 60),
        (b"-Y 0 +X 3", b"\5" * 60),
        (b"-Y 900000 +X 900000", b"\2\2"),
        (b"-Y 99999999999 +X 2", b"\2\2"),
    ],
)
def test_damage(path, head, pixels):
    path.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n" + head + b"\n" + pixels)
    with pytest.raises(ValueError, match=r"a\.hdr: not a readable Radiance \.hdr image \(.+\)$"):
        read_image(path)


def test_headers_of_other_programs(path):
    path.write_bytes(b"ENVI\nsamples = 3\n\n")
    with pytest.raises(ValueError, match=r"a\.hdr: is the header of an ENVI data set, no picture; write"):
        read_image(path)
    path.write_bytes(b"hello")
    message = f"{path}: not a readable Radiance .hdr image (no blank line ends its header)"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        read_image(path)


def test_a_mask_needs_no_colours(path):
    rgbe = np.zeros((8, 9, 4), "u1")
    rgbe[2:5, 3:7] = [255, 255, 255, 136]
    path.write_bytes(hdr(rgbe, "PRIMARIES=0 0 0 0 0 0 0 0"))
    assert open_mask(path).marked.sum() == 12


def test_what_is_written_is_read(path):
    write_image(path, picture())
    stored = read_stored(path)
    assert stored.values.flags.c_contiguous
    assert stored.colours() == (None, None)
    assert abs(stored.values - picture().numpy()).max() <= 100 / 128


def test_one_column_from_right_to_left(path):
    """An axis of one pixel hides its direction from NumPy, and torch takes no negative strides."""
    stored = np.full((3, 1, 4), 128, "u1")
    path.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-X 3 -Y 1\n" + stored.tobytes())
    assert read_image(path).shape == (3, 1, 3)
