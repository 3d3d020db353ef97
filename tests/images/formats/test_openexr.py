"""OpenEXR files that programs write: channels, layers, parts, windows, colours."""

import struct

import numpy as np
import OpenEXR
import pytest
import torch

from picture_files import picture, rgb, window, write_exr, write_exr_parts
from torchbrdf.images import open_mask, read_image, read_picture, read_vectors
from torchbrdf.images.formats import Window, openexr, read_stored
from torchbrdf.images.primaries import SPACES, conversion

LOSSLESS = ("NO", "RLE", "ZIPS", "ZIP", "PIZ")
LOSSY = ("PXR24", "B44", "B44A", "DWAA", "DWAB")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.exr"


@pytest.mark.parametrize("dtype", ["float16", "float32", "uint32"])
@pytest.mark.parametrize("extra", [(), ("A",), ("A", "Z", "depth.V")])
def test_channel_types_and_extra_channels(path, dtype, extra):
    names = ("B", "R", *extra, "G")
    planes = {name: np.arange(12, dtype=dtype).reshape(3, 4) + 10 * k for k, name in enumerate(names)}
    write_exr(path, planes)
    read = read_image(path)
    for k, channel in enumerate("RGB"):
        assert torch.equal(read[k], torch.from_numpy(planes[channel].astype("f4")))


@pytest.mark.parametrize("compression", LOSSLESS + LOSSY)
@pytest.mark.parametrize("dtype", ["float16", "float32"])
def test_compressions(path, compression, dtype):
    rows, columns = np.mgrid[:40, :50]
    values = np.stack([rows / 40, columns / 50, (rows + columns) / 90]).astype(dtype)
    write_exr(path, rgb(values), compression=getattr(OpenEXR, f"{compression}_COMPRESSION"))
    read = read_image(path).numpy()
    if compression in LOSSLESS:
        assert np.array_equal(read, values.astype("f4"))
    np.testing.assert_allclose(read, values, atol=0.02)


def test_tiles(path):
    values = picture(50, 70).numpy()
    tiles = OpenEXR.TileDescription()
    tiles.xSize, tiles.ySize = 32, 16
    write_exr(path, rgb(values), type=OpenEXR.tiledimage, tiles=tiles)
    assert np.array_equal(read_image(path), values)


@pytest.mark.parametrize("dtype", ["float16", "float32"])
def test_tiles_larger_than_the_picture(path, dtype):
    values = picture(5, 7).numpy().astype(dtype)
    tiles = OpenEXR.TileDescription()
    tiles.xSize = tiles.ySize = 2048
    write_exr(path, rgb(values), type=OpenEXR.tiledimage, tiles=tiles)
    assert np.array_equal(read_image(path), values.astype("f4"))


def test_tiles_that_ask_for_gigabytes(path, monkeypatch):
    tiles = OpenEXR.TileDescription()
    tiles.xSize, tiles.ySize = 16, 8
    write_exr(path, rgb(picture(8, 16).numpy()), type=OpenEXR.tiledimage, tiles=tiles)
    content = path.read_bytes()
    at = content.index(b"tiles\0tiledesc\0") + 19
    path.write_bytes(content[:at] + struct.pack("<II", 8, 1 << 24) + content[at + 8 :])
    monkeypatch.setattr(openexr, "_planes", lambda *_: pytest.fail("decoded"))
    with pytest.raises(ValueError, match=r"a\.exr: not a readable .* \(its tiles claim 8 x 16777216 pixels\)$"):
        read_image(path)


@pytest.mark.parametrize("compression", [*LOSSLESS[1:], *LOSSY])
@pytest.mark.parametrize("dtype", ["float16", "float32"])
def test_what_compresses_best_is_read(path, compression, dtype):
    """A black mask."""
    black = np.zeros((1024, 1024), dtype)
    write_exr(path, {"Y": black}, compression=getattr(OpenEXR, f"{compression}_COMPRESSION"))
    assert np.array_equal(read_stored(path).values, black[None])


def test_display_windows_that_little_data_cannot_ask_for(path):
    write_exr(path, rgb(picture(8, 8).numpy()), displayWindow=window(0, 0, 1, 1 << 21))
    with pytest.raises(ValueError, match=r"\(its windows claim 8 x 8 and 2 x 2097153 pixels\)$"):
        read_image(path)


def test_a_small_crop_of_a_large_render(path):
    values = picture(64, 64).numpy()
    write_exr(path, rgb(values), dataWindow=window(900, 500, 963, 563), displayWindow=window(0, 0, 4095, 2159))
    read = read_picture(path)
    assert read.image.shape == (3, 2160, 4096)
    assert np.array_equal(read.image[:, *read.window.slices], values)


def test_parts_that_are_not_read_must_fit_too(path, monkeypatch):
    """The library decodes all of them."""
    values = picture(4, 5).numpy()
    write_exr_parts(path, {"main": rgb(values), "other": {"Z": values[0]}})
    content = path.read_bytes()
    at = content.rindex(b"dataWindow\0box2i\0") + 21 + 8
    path.write_bytes(content[:at] + struct.pack("<ii", 9999, 9999) + content[at + 8 :])
    monkeypatch.setattr(openexr, "_planes", lambda *_: pytest.fail("decoded"))
    with pytest.raises(ValueError, match=r"\(its windows claim 10000 x 10000 and 5 x 4 pixels\)$"):
        read_image(path)


def test_names_of_layers_that_do_not_print_are_escaped(path):
    values = picture(4, 5).numpy()
    write_exr(path, {**rgb(values, "a\x1b."), **rgb(values, "b.")})
    with pytest.raises(ValueError, match=r"a\\x1b, b$"):
        read_image(path)


def test_infinities_and_numbers_that_are_none_are_passed_on(path):
    values = np.ones((3, 2, 3), "f2")
    values[0, 0, 0], values[1, 1, 2] = np.inf, np.nan
    write_exr(path, rgb(values), chromaticities=sum(SPACES["aces-ap0"].values, ()))
    np.testing.assert_array_equal(torch.isfinite(read_image(path)), np.isfinite(values))


# The part that was recorded of a display window of 10 x 7 pixels whose corner is (5, 7).
@pytest.mark.parametrize(
    ("data", "recorded"),
    [
        ((5, 7, 14, 13), None),
        ((0, 0, 30, 30), None),
        ((7, 9, 9, 10), Window(2, 2, 3, 2)),
        ((3, 8, 8, 11), Window(0, 1, 4, 4)),
        ((12, 3, 20, 9), Window(7, 0, 3, 3)),
        ((-5, 10, 40, 10), Window(0, 3, 10, 1)),
        ((14, 13, 20, 20), Window(9, 6, 1, 1)),
    ],
)
def test_pixels_stand_in_the_display_window(path, data, recorded):
    x0, y0, x1, y1 = data
    pixels = picture(y1 - y0 + 1, x1 - x0 + 1).numpy()
    write_exr(path, rgb(pixels), dataWindow=window(*data), displayWindow=window(5, 7, 14, 13))
    read = read_picture(path)
    assert read.window == recorded
    assert read.image.shape == (3, 7, 10)
    for row, column in np.ndindex(7, 10):
        y, x = row + 7 - y0, column + 5 - x0
        inside = 0 <= y < pixels.shape[1] and 0 <= x < pixels.shape[2]
        expected = pixels[:, y, x] if inside else np.full(3, np.nan)
        np.testing.assert_array_equal(read.image[:, row, column], expected)


def test_windows_apart(path):
    values = picture(4, 6).numpy()
    write_exr(path, rgb(values), dataWindow=window(3, 8, 8, 11), displayWindow=window(20, 20, 21, 21))
    with pytest.raises(ValueError, match=r"a\.exr: recorded nothing of its display window"):
        read_image(path)


@pytest.mark.parametrize("space", ["aces-ap0", "aces-ap1", "rec2020", "p3-d65", "xyz"])
def test_chromaticities_are_converted(path, space):
    values = picture(3, 4).numpy()
    write_exr(path, rgb(values), chromaticities=sum(SPACES[space].values, ()))
    expected = np.einsum("ij,jhw->ihw", conversion(SPACES[space], SPACES["rec709"]), values)
    read = read_picture(path)
    np.testing.assert_allclose(read.image, expected, rtol=1e-5, atol=1e-4)
    assert read.about[0] == f"{space} to rec709"


def test_chromaticities_that_span_no_space(path):
    write_exr(path, rgb(picture(2, 2).numpy()), chromaticities=(0.64, 0.33) * 3 + (0.3127, 0.329))
    with pytest.raises(ValueError, match=r"a\.exr: chromaticities: these primaries span no colour space"):
        read_image(path)
    assert read_vectors(path).shape == (3, 2, 2)


@pytest.mark.parametrize(
    ("names", "prefix", "label"),
    [
        (("r", "g", "b"), "", "rgb"),
        (("red", "green", "blue"), "", "redgreenblue"),
        (("Red", "Green", "Blue"), "", "RedGreenBlue"),
        (("RED", "GREEN", "BLUE"), "", "REDGREENBLUE"),
        (("R", "G", "B"), "beauty.", "beauty"),
        (("R", "G", "B"), "ViewLayer.Combined.", "ViewLayer.Combined"),
        (("red", "green", "blue"), "rgba.", "rgba"),
    ],
)
def test_the_only_colours_are_taken_whatever_they_are_called(path, names, prefix, label):
    values = picture().numpy()
    write_exr(path, {**rgb(values, prefix, names), "Z": values[0], "normal.X": values[1], "gamma.G": values[2]})
    for layer in (None, label, label.upper()):
        read = read_picture(path, layer=layer)
        assert np.array_equal(read.image, values)
        assert read.about == (f"layer {label}",)


def test_colours_in_another_part(path):
    values = picture().numpy()
    write_exr_parts(path, {"depth": {"Z": values[0]}, "beauty": rgb(values)})
    read = read_picture(path)
    assert np.array_equal(read.image, values)
    assert read.about == ("layer beauty",)


def test_plain_channels_of_the_first_part_are_the_picture(path):
    values = picture().numpy()
    write_exr(path, {**rgb(values), **rgb(values + 1, "diffuse."), **rgb(values + 2, names="rgb")})
    read = read_picture(path)
    assert np.array_equal(read.image, values)
    assert read.about == ()
    assert np.array_equal(read_image(path, layer="diffuse"), values + 1)
    assert np.array_equal(read_image(path, layer="rgb"), values + 2)
    assert np.array_equal(read_image(path, layer="RGB"), values)


def test_several_pictures_are_listed(path):
    values = picture().numpy()
    write_exr(path, {**rgb(values, "beauty."), **rgb(values, "diffuse.")})
    message = r"a\.exr: holds several pictures; choose one: --layer NAME \(layer= in Python\) of beauty, diffuse$"
    with pytest.raises(ValueError, match=message):
        read_image(path)
    with pytest.raises(ValueError, match=r"a\.exr: has no layer 'specular'; it has beauty, diffuse$"):
        read_image(path, layer="specular")
    write_exr_parts(path, {"left": rgb(values), "right": {**rgb(values + 1), **rgb(values + 2, "fog.")}})
    with pytest.raises(ValueError, match=r"of left, right, right\.fog$"):
        read_image(path)
    write_exr_parts(path, {"first": rgb(values, "fog."), "second": rgb(values)})
    with pytest.raises(ValueError, match=r"of first\.fog, second$"):
        read_image(path)
    write_exr_parts(path, {"left": rgb(values), "right": {**rgb(values + 1), **rgb(values + 2, "fog.")}})
    with pytest.raises(ValueError, match=r"of left, right, right\.fog$"):
        read_image(path)
    for add, label in enumerate(("left", "right", "right.fog")):
        assert np.array_equal(read_image(path, layer=label), values + np.float32(add))


def test_colours_under_two_kinds_of_names_are_two_pictures(path):
    values = picture().numpy()
    write_exr(path, {**rgb(values, names="rgb"), **rgb(values + 1, names=("red", "green", "blue"))})
    with pytest.raises(ValueError, match=r"of rgb, redgreenblue$"):
        read_image(path)
    assert np.array_equal(read_image(path, layer="redgreenblue"), values + 1)


def test_files_without_colours(path):
    plane = np.ones((2, 2), "f4")
    write_exr(path, {"Y": plane})
    with pytest.raises(ValueError, match=r"a\.exr: expected R, G, B channels, got one of grey$"):
        read_image(path)
    write_exr(path, {"X": plane, "Z": plane})
    with pytest.raises(ValueError, match=r"a\.exr: expected R, G, B channels, got \['X', 'Z'\]$"):
        read_image(path)
    write_exr(path, {"X": plane, "Y": plane, "Z": plane})
    with pytest.raises(ValueError, match=r"got .*; X, Y, Z may be vectors or CIE XYZ: write R, G, B$"):
        read_image(path)
    write_exr_parts(path, {"a": {"Y": plane}, "b": {"A": plane}})
    with pytest.raises(ValueError, match=r"got \['A', 'Y'\]$"):
        read_image(path)
    with pytest.raises(ValueError, match=r"has no layer 'x'; it has none with R, G, B$"):
        read_image(path, layer="x")


def subsampled(steps: dict[str, int], size: int = 4) -> bytes:
    """An uncompressed half-float file; the library writes no channels of which every n-th pixel is stored."""

    def attribute(name: str, kind: str, value: bytes) -> bytes:
        return f"{name}\0{kind}\0".encode() + struct.pack("<i", len(value)) + value

    box = struct.pack("<4i", 0, 0, size - 1, size - 1)
    channels = b"".join(name.encode() + struct.pack("<xiiii", 1, 0, steps[name], steps[name]) for name in sorted(steps))
    begin = b"\x76\x2f\x31\x01\2\0\0\0" + b"".join(
        [
            attribute("channels", "chlist", channels + b"\0"),
            attribute("compression", "compression", b"\0"),
            attribute("dataWindow", "box2i", box),
            attribute("displayWindow", "box2i", box),
            attribute("lineOrder", "lineOrder", b"\0"),
            attribute("pixelAspectRatio", "float", struct.pack("<f", 1)),
            attribute("screenWindowCenter", "v2f", bytes(8)),
            attribute("screenWindowWidth", "float", struct.pack("<f", 1)),
            b"\0",
        ]
    )
    blocks = []
    for row in range(size):
        pixels = b"".join(np.ones(size // steps[n], "<f2").tobytes() for n in sorted(steps) if row % steps[n] == 0)
        blocks.append(struct.pack("<ii", row, len(pixels)) + pixels)
    starts = np.cumsum([len(begin) + 8 * size, *map(len, blocks[:-1])])
    return begin + starts.astype("<u8").tobytes() + b"".join(blocks)


def test_luminance_and_chroma_are_named(path):
    path.write_bytes(subsampled({"Y": 1, "RY": 2, "BY": 2}))
    with pytest.raises(ValueError, match=r"a\.exr: is a luminance/chroma image \(Y, RY, BY\); write it as R, G, B$"):
        read_image(path)


def test_subsampled_colours_are_named(path):
    path.write_bytes(subsampled({"R": 1, "G": 1, "B": 1}))
    assert torch.equal(read_image(path), torch.ones(3, 4, 4))
    path.write_bytes(subsampled({"R": 2, "G": 1, "B": 2}))
    with pytest.raises(ValueError, match=r"a\.exr: its channel R is subsampled; write all channels at full size$"):
        read_image(path)


def test_deep_images_are_named(path):
    samples = np.empty((2, 3), dtype=object)
    for place in np.ndindex(2, 3):
        samples[place] = np.ones(2, "f4")
    header = {"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.deepscanline}
    with OpenEXR.File(header, rgb(np.stack([samples] * 3))) as file:
        file.write(str(path))
    with pytest.raises(ValueError, match=r"a\.exr: is a deep image, many samples in each pixel; flatten it"):
        read_image(path)


@pytest.mark.parametrize("ratio", [1.0, 1.0005])
def test_square_pixels(path, ratio):
    write_exr(path, rgb(picture().numpy()), pixelAspectRatio=ratio)
    assert torch.equal(read_image(path), picture())


@pytest.mark.parametrize("ratio", [2.0, 0.9])
def test_pixels_that_are_not_square(path, ratio):
    write_exr(path, rgb(picture().numpy()), pixelAspectRatio=ratio)
    with pytest.raises(ValueError, match=rf"a\.exr: pixels are not square \(pixel aspect ratio {ratio:g}\)"):
        read_image(path)


@pytest.mark.parametrize(
    ("prefix", "name"), [("", "A"), ("", "a"), ("", "alpha"), ("beauty.", "A"), ("beauty.", "Alpha")]
)
def test_alpha(path, prefix, name):
    values, alpha = picture(3, 4).numpy(), np.linspace(0, 1, 12, dtype="f4").reshape(3, 4)
    write_exr(path, {**rgb(values, prefix), prefix + name: alpha, "other.A": 1 - alpha})
    assert np.array_equal(read_picture(path).alpha, alpha[None])


@pytest.mark.parametrize("value", [0.0, 0.7, 1.0])
def test_alpha_that_tells_nothing_is_none(path, value):
    values = picture(4, 6).numpy()
    channels = {**rgb(values), "A": np.full((4, 6), value, "f4")}
    write_exr(path, channels)
    assert read_picture(path).alpha is None
    channels["A"][1, 2] *= 1 - 1e-6  # as a sum over samples is off
    write_exr(path, channels, dataWindow=window(3, 2, 8, 5), displayWindow=window(0, 0, 20, 20))
    assert read_picture(path).alpha is None
    channels["A"][1, 2] = 0.3
    write_exr(path, channels, dataWindow=window(3, 2, 8, 5), displayWindow=window(0, 0, 20, 20))
    alpha = read_picture(path).alpha
    assert alpha[0, 3, 5] == np.float32(0.3)
    assert alpha[0, 0, 0] == 0


def test_masks_are_one_channel_of_any_name(path):
    white = np.eye(4, dtype="f4")
    for name in ("Y", "Z", "A", "mask.V"):
        write_exr(path, {name: white})
        assert np.array_equal(open_mask(path).marked[0], white > 0)
    write_exr(path, {"Y": white, "A": np.ones((4, 4), "f4")})
    assert np.array_equal(open_mask(path).marked[0], white > 0)


def test_vectors_are_taken_from_their_own_channels(path):
    values = picture().numpy()
    write_exr(path, {**rgb(values), **rgb(values + 1, "N.", "XYZ")})
    assert np.array_equal(read_vectors(path), values + 1)
    assert np.array_equal(read_vectors(path, layer="RGB"), values)
    assert np.array_equal(read_image(path), values)
    write_exr(path, {**rgb(values, names="XYZ"), **rgb(values + 1, "P.", "XYZ")})
    assert np.array_equal(read_vectors(path), values)


@pytest.mark.parametrize("compression", ["NO", "ZIP", "DWAA"])
def test_no_truncated_file_is_read(path, compression, capfd):
    write_exr(path, rgb(picture(3, 4).numpy()), compression=getattr(OpenEXR, f"{compression}_COMPRESSION"))
    whole = path.read_bytes()
    read_stored(path)
    for length in range(1, len(whole), 3):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"a\.exr: not a readable OpenEXR image"):
            read_stored(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("corner", [(900_000, 900_000), (16_711_688, 5), (5, 16_777_221)])
def test_windows_that_cannot_be_meant(path, corner):
    write_exr(path, rgb(np.zeros((3, 2, 2), "f4")), displayWindow=window(0, 0, *corner))
    size = f"{corner[0] + 1} x {corner[1] + 1}"
    with pytest.raises(ValueError, match=rf"a\.exr: not a readable .* \(its windows claim 2 x 2 and {size} "):
        read_image(path)


def test_names_of_channels_that_are_no_text(path):
    write_exr(path, rgb(np.zeros((3, 2, 2), "f4")))
    path.write_bytes(path.read_bytes().replace(b"G\0", b"\x80\0", 1))
    with pytest.raises(ValueError, match=r"a\.exr: not a readable OpenEXR image"):
        read_image(path)


def test_a_data_window_that_the_file_cannot_hold(path):
    write_exr(path, rgb(np.zeros((3, 2, 2), "f4")), dataWindow=window(0, 0, 1, 1))
    box = np.array([0, 0, 1, 1], "<i4").tobytes()
    path.write_bytes(path.read_bytes().replace(box, np.array([0, 0, 9999, 9999], "<i4").tobytes()))
    with pytest.raises(ValueError, match=r"a\.exr: not a readable OpenEXR image \(its windows claim 10000 x 10000"):
        read_image(path)


@pytest.mark.parametrize("compression", ["DWAB", "ZIP", "PIZ"])
def test_black_pictures_are_small_files(path, compression):
    black = np.zeros((2048, 2048), "f2")
    write_exr(path, {"Y": black}, compression=getattr(OpenEXR, f"{compression}_COMPRESSION"))
    assert not open_mask(path).marked.any()
