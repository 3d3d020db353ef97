"""TIFF files: types of numbers, compressions, layouts, alpha, orientation, colours."""

import struct

import cv2
import numpy as np
import pytest
import tifffile
import torch
from PIL import Image, ImageCms

from picture_files import as_orientation, disc, picture
from torchbrdf.images import open_mask, read_image, read_picture, read_vectors
from torchbrdf.images.formats import read_stored

FLOAT = picture(30, 41).permute(1, 2, 0).numpy()
BYTES = np.random.default_rng(0).integers(0, 256, (30, 41, 3)).astype("u1")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.tif"


def save(path, pixels: np.ndarray, **options: object) -> None:
    tifffile.imwrite(path, pixels, **{"photometric": "rgb", **options})


def change(path, **tags: int) -> None:
    """Overwrites the numbers of tags that have one."""
    changed = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as file:
        for name, number in tags.items():
            tag = file.pages[0].tags[name]
            place, size = tag.valueoffset, tag.valuebytecount
            changed[place : place + size] = number.to_bytes(size, "little")
    path.write_bytes(changed)


@pytest.mark.parametrize("dtype", ["<f2", "<f4", "<f8", ">f4", ">f8"])
@pytest.mark.parametrize("big", [False, True])
def test_floating_point_values_are_radiance(path, dtype, big):
    save(path, FLOAT.astype(dtype), byteorder=dtype[0], bigtiff=big)
    read = read_picture(path)
    assert np.array_equal(read.image.permute(1, 2, 0), FLOAT.astype(dtype).astype("f4"))
    assert read.about == ()
    assert read.alpha is None


@pytest.mark.parametrize(
    ("compression", "predictor"),
    [
        *((name, False) for name in ("none", "packbits", "lzma", "lzw")),
        *((name, True) for name in ("lzw", "deflate", "zstd")),
    ],
)
@pytest.mark.parametrize(
    "layout", [{}, {"rowsperstrip": 7}, {"tile": (16, 32)}, {"planarconfig": "separate", "rowsperstrip": 7}]
)
def test_compressions_and_layouts(path, compression, predictor, layout):
    pixels = FLOAT.transpose(2, 0, 1) if "planarconfig" in layout else FLOAT
    save(path, np.ascontiguousarray(pixels), compression=compression, predictor=predictor, **layout)
    assert np.array_equal(read_image(path).permute(1, 2, 0), FLOAT)


@pytest.mark.parametrize("name", ["a.tif", "a.tiff", "A.TIF"])
def test_files_of_another_writer(tmp_path, name):
    cv2.imwrite(str(tmp_path / name), FLOAT[..., ::-1], [cv2.IMWRITE_TIFF_COMPRESSION, 1])
    assert np.array_equal(read_image(tmp_path / name).permute(1, 2, 0), FLOAT)


@pytest.mark.parametrize("dtype", ["u1", "u2", ">u2"])
def test_integers_are_over_their_full_scale(path, dtype):
    pixels = BYTES.astype(dtype) * np.array(257 if dtype.endswith("2") else 1, dtype)
    save(path, pixels)
    np.testing.assert_allclose(read_vectors(path).permute(1, 2, 0), BYTES / 255, atol=1e-6)
    read = read_picture(path, allow_ldr=True)
    np.testing.assert_allclose(read.image.permute(1, 2, 0), (BYTES / 255) ** 2.2, atol=1e-5)
    assert read.about == (f"{8 * pixels.dtype.itemsize}-bit TIFF decoded with gamma 2.2",)
    with pytest.raises(ValueError, match=r"a\.tif: \d+-bit TIFF is not linear HDR; .* to decode it with gamma 2\.2$"):
        read_image(path)


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_numbers_of_fewer_bits_than_their_type(path, bits):
    ramp = np.linspace(0, 2**bits - 1, 60).astype("u2").reshape(4, 15)
    places = np.unpackbits(ramp.astype(">u2").view("u1").reshape(4, 15, 2), axis=2)[..., 16 - bits :]
    save(path, np.packbits(places.reshape(4, -1), axis=1), photometric="minisblack")
    change(path, ImageWidth=15, BitsPerSample=bits)
    stored = read_stored(path)
    np.testing.assert_allclose(stored.values[0], ramp / (2**bits - 1), atol=1e-6)
    assert stored.kind == f"{bits}-bit TIFF"


@pytest.mark.parametrize("photometric", ["minisblack", "miniswhite"])
@pytest.mark.parametrize("dtype", ["u1", "u2", "?"])
def test_grey_counts_from_black_or_from_white(path, photometric, dtype):
    white = disc()
    stored = white if photometric == "minisblack" else ~white
    top = True if dtype == "?" else np.iinfo(dtype).max
    save(path, np.where(stored, top, 0).astype(dtype), photometric=photometric)
    assert np.array_equal(open_mask(path).marked[0], white)


FAX = pytest.mark.skipif(4 not in tifffile.TIFF.DECOMPRESSORS, reason="this imagecodecs reads no fax")


@pytest.mark.parametrize(
    "compression",
    [None, "packbits", "tiff_lzw", "tiff_deflate", *(pytest.param(name, marks=FAX) for name in ("group3", "group4"))],
)
def test_masks_of_one_bit(path, compression):
    Image.fromarray(disc()).save(path, compression=compression)
    assert np.array_equal(open_mask(path).marked[0], disc())


@pytest.mark.parametrize(("code", "name"), [(34676, "SGILOG"), (12345, "12345")])
def test_compressions_that_are_not_read(path, code, name):
    save(path, FLOAT)
    change(path, Compression=code)
    message = rf"a\.tif: is compressed in a way that is not read \({name}\); save it with LZW or Deflate$"
    with pytest.raises(ValueError, match=message):
        read_image(path)


def test_many_pages_are_not_all_counted(path):
    save(path, np.zeros((120, 4, 5, 3), "u1"))
    with pytest.raises(ValueError, match=r"a\.tif: holds 100 or more pictures; write the one"):
        read_stored(path)


def test_a_compression_that_is_no_number(path):
    save(path, FLOAT)
    with tifffile.TiffFile(path) as file:
        entry = file.pages[0].tags["Compression"].offset
    content = bytearray(path.read_bytes())
    content[entry + 2 : entry + 12] = struct.pack("<HI4s", 2, 1, b"\1")  # text in place of a number
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.tif: not a readable TIFF image"):
        read_image(path)


@pytest.mark.parametrize("compression", ["packbits", "lzw", "zlib"])
def test_what_compresses_best_is_read(path, compression):
    save(path, np.zeros((1 << 11, 1 << 11), "u1"), photometric="minisblack", compression=compression)
    assert path.stat().st_size < 1 << 17
    assert read_stored(path).values.shape == (1, 1 << 11, 1 << 11)


@pytest.mark.parametrize("compression", [None, "packbits", "lzw", "zlib"])
def test_more_pixels_than_the_bytes_can_hold(path, compression, monkeypatch):
    save(path, FLOAT, compression=compression, rowsperstrip=len(FLOAT))
    change(path, ImageLength=1 << 20, RowsPerStrip=1 << 20)
    monkeypatch.setattr(tifffile.TiffPage, "asarray", lambda page: pytest.fail("decoded"))
    with pytest.raises(ValueError, match=r"a\.tif: not a readable TIFF image"):
        read_image(path)


ALPHA = np.linspace(0, 1, FLOAT[..., 0].size, dtype="f4").reshape(FLOAT.shape[:2])


@pytest.mark.parametrize("kind", ["assocalpha", "unassalpha"])
def test_alpha(path, kind):
    save(path, np.dstack([FLOAT, ALPHA]), extrasamples=[kind])
    read = read_picture(path)
    assert np.array_equal(read.alpha[0], ALPHA)
    assert read.about == ()
    save(path, np.dstack([BYTES, (ALPHA * 255).astype("u1")]), extrasamples=[kind])
    np.testing.assert_allclose(read_stored(path).alpha, ALPHA, atol=1 / 255)


def test_a_fourth_channel_without_a_name_is_alpha_where_it_can_be(path):
    save(path, np.dstack([FLOAT, ALPHA]), extrasamples=["unspecified"])
    read = read_picture(path)
    assert np.array_equal(read.alpha[0], ALPHA)
    assert read.about == ("a channel beside its colours, which it does not name, taken as alpha",)
    save(path, np.dstack([FLOAT, 10 * ALPHA]), extrasamples=["unspecified"])
    assert read_picture(path).alpha is None
    cv2.imwrite(str(path), np.dstack([BYTES, (ALPHA * 255).astype("u1")]))
    assert read_picture(path, allow_ldr=True).about[0].startswith("a channel beside its colours")


def test_alpha_that_is_the_same_everywhere_is_none(path):
    Image.fromarray(BYTES).convert("RGBA").save(path)
    assert read_picture(path, allow_ldr=True).alpha is None


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation(path, orientation):
    save(path, as_orientation(FLOAT, orientation), extratags=[(274, "H", 1, orientation, True)])
    assert np.array_equal(read_image(path).permute(1, 2, 0), FLOAT)


def test_profiles(path):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    save(path, BYTES, iccprofile=profile)
    assert read_picture(path, allow_ldr=True).about == ("8-bit TIFF decoded with sRGB",)
    save(path, FLOAT, iccprofile=profile)
    message = (
        r"a\.tif: its profile names a curve \(sRGB\) for its floating-point values; export it linear, or pass "
        r'--encoding linear \(encoding="linear" in Python\) where it is$'
    )
    with pytest.raises(ValueError, match=message):
        read_image(path)
    assert np.array_equal(read_image(path, encoding="linear").permute(1, 2, 0), FLOAT)


def test_chromaticities(path):
    def rationals(*numbers: float) -> tuple[int, ...]:
        return tuple(part for number in numbers for part in (round(number * 10_000), 10_000))

    white, primaries = rationals(0.3127, 0.3290), rationals(0.708, 0.292, 0.170, 0.797, 0.131, 0.046)
    save(path, FLOAT, extratags=[(318, "2I", 2, white, True), (319, "2I", 6, primaries, True)])
    assert read_picture(path).about[0] == "rec2020 to rec709"
    assert np.array_equal(read_image(path, primaries="rec2020").permute(1, 2, 0), FLOAT)
    save(path, FLOAT, extratags=[(318, "2I", 2, white, True), (319, "2I", 6, (1, 0) * 6, True)])
    with pytest.raises(ValueError, match=r"a\.tif: PrimaryChromaticities and WhitePoint: chromaticities must"):
        read_image(path)


def test_previews_are_passed_over(path):
    with tifffile.TiffWriter(path) as file:
        file.write(FLOAT, photometric="rgb")
        file.write(BYTES[::2, ::2], photometric="rgb", subfiletype=1)
    assert np.array_equal(read_image(path).permute(1, 2, 0), FLOAT)
    with tifffile.TiffWriter(path) as file:
        file.write(BYTES[::2, ::2], photometric="rgb", subfiletype=1)
        file.write(FLOAT, photometric="rgb")
    assert np.array_equal(read_image(path).permute(1, 2, 0), FLOAT)


@pytest.mark.parametrize(
    ("pixels", "options", "message"),
    [
        (np.stack([FLOAT, FLOAT]), {}, "holds 2 pictures; write the one that is meant to a file of its own"),
        (BYTES, {"subfiletype": 1}, "holds previews alone, as cameras' raw files do; develop it to a linear .exr"),
        (BYTES[..., 0], {"photometric": "cfa"}, "holds pixels of the kind CFA; write R, G, B"),
        (BYTES[..., 0], {"photometric": "palette", "colormap": np.zeros((3, 256), "u2")}, "holds .* PALETTE; write"),
        (np.dstack([BYTES, BYTES[..., 0]]), {"photometric": "separated"}, "holds pixels of the kind SEPARATED"),
        (BYTES.astype("u4"), {}, "holds uint32 values; write 32-bit floating-point ones, or 16-bit unsigned integers"),
        (BYTES.astype("i2"), {}, "holds int16 values"),
        (FLOAT.astype("c8"), {}, "holds complex64 values"),
        (FLOAT[..., 0], {"photometric": "miniswhite"}, "holds floating-point values with 0 for white"),
    ],
)
def test_pictures_that_are_no_grey_or_rgb(path, pixels, options, message):
    save(path, pixels, **options)
    with pytest.raises(ValueError, match=rf"a\.tif: {message}"):
        read_image(path, allow_ldr=True)


@pytest.mark.parametrize("options", [{}, {"compression": "deflate"}, {"tile": (16, 16)}, {"compression": "lzw"}])
def test_no_truncated_file_is_read(path, options, capfd):
    save(path, FLOAT[:5, :6], **options)
    whole = path.read_bytes()
    read_stored(path)
    for length in (*range(1, len(whole), 1 + len(whole) // 100), len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"a\.tif: not a readable TIFF image"):
            read_stored(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("compression", ["none", "deflate", "lzw"])
def test_strips_that_end_early(path, compression):
    save(path, FLOAT, compression=compression, rowsperstrip=10)
    with tifffile.TiffFile(path) as file:
        page = file.pages[0]
        tag, counts = page.tags["StripByteCounts"], page.databytecounts
    whole = path.read_bytes()
    size = tag.valuebytecount // tag.count
    for count in (0, 5, counts[1] // 2, counts[1] - 40):
        changed = bytearray(whole)
        changed[tag.valueoffset + size : tag.valueoffset + 2 * size] = struct.pack("<I", count)[:size]
        path.write_bytes(changed)
        with pytest.raises(ValueError, match=r"a\.tif: not a readable TIFF image"):
            read_image(path)


def test_a_header_that_asks_for_terabytes_is_refused(path):
    save(path, FLOAT)
    change(path, ImageWidth=60_000, ImageLength=60_000)
    with pytest.raises(ValueError, match=r"a\.tif: not a readable TIFF image"):
        read_image(path)


def test_values_can_be_written_to(path):
    save(path, FLOAT)
    assert torch.equal(read_image(path).add_(1), torch.from_numpy(FLOAT).permute(2, 0, 1) + 1)


def test_a_profile_that_is_text(path):
    save(path, FLOAT, extratags=[(34675, "s", 0, "no profile", True)])
    with pytest.raises(ValueError, match=r"a\.tif: not a readable TIFF image \(its colour profile is damaged\)$"):
        read_image(path)
