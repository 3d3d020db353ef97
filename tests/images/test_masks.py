"""Masks, however a file marks the shape."""

import zlib

import cv2
import numpy as np
import pytest
import tifffile
import torch
from PIL import Image

from picture_files import chunk, disc, png, png_of, rgb, window, write_exr
from torchbrdf.images import Mask, open_mask, read_mask

DISC = disc()
RANDOM = np.random.default_rng(0)
PHOTO = RANDOM.integers(30, 220, (*DISC.shape, 3)).astype("u1")


def smooth(shape: np.ndarray = DISC, sigma: float = 1.0) -> np.ndarray:
    return cv2.GaussianBlur(shape.astype("f4"), (0, 0), sigma)


def anti_aliased(times: int = 2) -> np.ndarray:
    """A disc in [0, 1] whose edge pixels show how much of them it covers."""
    large = disc(40 * times, 50 * times, 19.5 * times, 22.5 * times, 12 * times)
    return large.reshape(40, times, 50, times).mean(axis=(1, 3))


@pytest.fixture
def png_mask(tmp_path):
    """Opens a mask of these pixels in a PNG file."""

    def opened(pixels: np.ndarray, chunks: bytes = b"") -> Mask:
        (tmp_path / "mask.png").write_bytes(png_of(pixels, chunks))
        return open_mask(tmp_path / "mask.png")

    return opened


def is_disc(mask: Mask, shape: np.ndarray = DISC) -> bool:
    assert mask.marked.dtype == torch.bool
    return np.array_equal(mask.marked[0], shape)


def coloured(colour, shape: np.ndarray = DISC, dtype: str = "u1") -> np.ndarray:
    return (shape[..., None] * np.array(colour)).astype(dtype)


@pytest.mark.parametrize("dtype", ["u1", "u2"])
def test_white_on_black(png_mask, dtype):
    mask = png_mask((DISC * np.iinfo(dtype).max).astype(dtype))
    assert is_disc(mask)
    assert mask.about == ""
    assert is_disc(png_mask((~DISC * np.iinfo(dtype).max).astype(dtype)), ~DISC)  # inverted: for others to judge


@pytest.mark.parametrize(("dtype", "label"), [("u1", 1), ("u2", 1), ("u1", 7), ("u1", 100), ("u2", 255)])
def test_one_label(png_mask, dtype, label):
    mask = png_mask((DISC * label).astype(dtype))
    assert is_disc(mask)
    assert mask.about == f"label {label}"


def test_the_brighter_of_two_values_is_the_mask_however_dim(png_mask):
    assert is_disc(png_mask(np.where(DISC, 33000, 32000).astype("u2")))
    assert is_disc(png_mask(np.where(DISC, 11, 10).astype("u1")))


@pytest.mark.parametrize("dtype", ["u1", "u2"])
@pytest.mark.parametrize("labels", [(0, 1, 2, 3), (1, 2, 3), (0, 15, 255), (0, 128, 255), (0, 100, 200)])
def test_several_labels_are_refused(png_mask, dtype, labels):
    quarters = np.array(labels + labels[-1:])[[[0, 1], [2, 3]]].repeat(20, axis=0).repeat(25, axis=1)
    which = ", ".join(map(str, sorted(set(labels))))
    message = rf"mask\.png: marks several things \({which}\); write 1 where the shape is, 0 elsewhere$"
    with pytest.raises(ValueError, match=message):
        png_mask(quarters.astype(dtype))


def test_a_trimap_is_refused(png_mask):
    core = disc(radius=8.0)
    with pytest.raises(ValueError, match=r"marks several things \(0, 128, 255\)"):
        png_mask(np.where(core, 255, np.where(DISC, 128, 0)).astype("u1"))


@pytest.mark.parametrize("colour", [(255, 0, 0), (0, 0, 90), (200, 180, 20), (192, 128, 128), (1, 0, 0)])
@pytest.mark.parametrize("dtype", ["u1", "u2"])
def test_one_colour_on_black(png_mask, colour, dtype):
    assert is_disc(png_mask(coloured(colour, dtype=dtype)))


def test_a_palette_that_names_one_class(tmp_path):
    """As VOC has them: black, and a dim colour; as an 8-bit palette."""
    palette = chunk(b"PLTE", bytes((0, 0, 0, 128, 0, 0, 0, 128, 0)))
    (tmp_path / "voc.png").write_bytes(png([row.tobytes() for row in DISC.astype("u1")], 50, 8, 3, palette))
    assert is_disc(open_mask(tmp_path / "voc.png"))
    both = np.where(disc(column=42.0, radius=7.0), 2, DISC).astype("u1")
    (tmp_path / "voc.png").write_bytes(png([row.tobytes() for row in both], 50, 8, 3, palette))
    with pytest.raises(ValueError, match=r"voc\.png: has several colours; paint the shape in one of them on black$"):
        open_mask(tmp_path / "voc.png")


@pytest.mark.parametrize("other", [(0, 0, 255), (255, 255, 0), (255, 255, 255), (60, 0, 0)])
def test_two_colours_are_refused(png_mask, other):
    pixels = coloured((255, 0, 0)) + coloured(other, disc(column=42.0, radius=7.0) & ~DISC)
    with pytest.raises(ValueError, match=r"several (colours|things)"):
        png_mask(pixels)


@pytest.mark.parametrize("times", [2, 4, 16])
@pytest.mark.parametrize("colour", [(255, 255, 255), (255, 0, 0), (0, 40, 80)])
def test_anti_aliased_edges_are_cut_at_half(png_mask, times, colour):
    cover = anti_aliased(times)
    certain = np.abs(cover - 0.5) > 0.02
    mask = png_mask((cover[..., None] * colour).round().astype("u1"))
    assert np.array_equal(mask.marked[0].numpy()[certain], (cover > 0.5)[certain])
    assert (~certain).sum() <= 20


@pytest.mark.parametrize("sigma", [0.5, 1.0])
@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_soft_edges_are_cut_at_half(tmp_path, sigma, suffix):
    soft = smooth(sigma=sigma)
    path = tmp_path / f"mask{suffix}"
    if suffix == ".png":
        path.write_bytes(png_of((soft * 65535).round().astype("u2")))
    else:
        write_exr(path, {"Y": soft})
    assert is_disc(open_mask(path), soft > soft.max() / 2)


@pytest.mark.parametrize("paint", ["white", "black", "photograph"])
@pytest.mark.parametrize("dtype", ["u1", "u2"])
def test_alpha_is_the_mask(png_mask, paint, dtype):
    top = np.iinfo(dtype).max
    colours = {"white": np.full_like(PHOTO, 255), "black": np.zeros_like(PHOTO), "photograph": PHOTO}[paint]
    mask = png_mask(np.dstack([colours.astype(dtype) * (top // 255), DISC * top]).astype(dtype))
    assert is_disc(mask)
    assert mask.about == "its alpha"


def test_a_white_disc_that_alpha_cuts_out(png_mask):
    grey = DISC.astype("u1") * 255
    assert is_disc(png_mask(np.dstack([grey, grey])))
    assert is_disc(png_mask(np.dstack([grey] * 4)))


def test_black_and_white_under_alpha_counts_where_it_is_opaque(png_mask):
    grey = DISC.astype("u1") * 255
    frame = np.full(DISC.shape, 255, "u1")
    frame[:2] = 0
    mask = png_mask(np.dstack([grey, grey, grey, frame]))
    assert is_disc(mask)
    assert mask.about == "white where it is opaque"


@pytest.mark.parametrize("opacity", [0, 100, 255])
def test_alpha_that_is_the_same_everywhere_is_none(png_mask, opacity):
    mask = png_mask(np.dstack([coloured((255,) * 3), np.full(DISC.shape, opacity, "u1")]))
    assert is_disc(mask)
    assert mask.about == ""


def test_alpha_of_a_part_that_was_recorded_is_none(tmp_path):
    channels = {**rgb(np.stack([DISC] * 3).astype("f4")), "A": np.ones(DISC.shape, "f4")}
    write_exr(tmp_path / "a.exr", channels, dataWindow=window(10, 5, 59, 44), displayWindow=window(0, 0, 79, 59))
    mask = open_mask(tmp_path / "a.exr")
    assert np.array_equal(mask.marked[0, 5:45, 10:60], DISC)
    assert mask.marked.sum() == DISC.sum()


def lambertian() -> np.ndarray:
    """A smooth grey ball on black."""
    rows, columns = np.mgrid[:40, :50]
    square = ((rows - 19) ** 2 + (columns - 22) ** 2) / 144
    return np.sqrt((1 - square).clip(0))[..., None] * np.ones(3)


SUFFIXES = (".png", ".jpg", ".exr", ".tif")


@pytest.mark.parametrize(
    ("suffix", "photograph", "highlight"),
    [
        *((suffix, PHOTO / 255, 0) for suffix in SUFFIXES),
        *((suffix, PHOTO / 255 * DISC[..., None], highlight) for suffix in SUFFIXES for highlight in (0, 1)),
        *((suffix, lambertian() ** power, 0) for suffix in SUFFIXES for power in (1, 1 / 2.2)),
        *((suffix, lambertian(), 1000) for suffix in (".exr", ".tif")),
    ],
)
def test_a_photograph_is_no_mask(tmp_path, suffix, photograph, highlight):
    values = photograph.copy()
    if highlight:
        values[15:18, 20:23] = highlight
    path = tmp_path / f"photo{suffix}"
    eight = (values * 255).astype("u1")
    {
        ".png": lambda: path.write_bytes(png_of(eight)),
        ".jpg": lambda: Image.fromarray(eight).save(path, quality=90),
        ".exr": lambda: write_exr(path, rgb(values.transpose(2, 0, 1).astype("f4"))),
        ".tif": lambda: tifffile.imwrite(path, values.astype("f4"), photometric="rgb"),
    }[suffix]()
    with pytest.raises(ValueError, match=r"photo\.\w+: (is no mask|has several colours)"):
        open_mask(path)


@pytest.mark.parametrize("colour", [(255, 255, 255), (255, 0, 0), (0, 90, 200)])
@pytest.mark.parametrize("subsampling", [0, 2])
@pytest.mark.parametrize("quality", [50, 90])
def test_masks_that_jpeg_has_smeared(tmp_path, colour, subsampling, quality):
    large = disc(120, 160, 60, 80, 40)
    Image.fromarray(coloured(colour, large)).save(tmp_path / "m.jpg", quality=quality, subsampling=subsampling)
    wrong = read_mask(tmp_path / "m.jpg")[0].numpy() ^ large
    edge = smooth(large, 1.5)
    assert not wrong[np.abs(edge - 0.5) > 0.45].any()


@pytest.mark.parametrize("dtype", ["f2", "f4", "u4"])
@pytest.mark.parametrize("white", [0.5, 1, 300])
def test_masks_in_openexr(tmp_path, dtype, white):
    plane = (DISC * np.ceil(white) if dtype == "u4" else DISC * white).astype(dtype)
    for channels in ({"Y": plane}, {"R": plane, "G": plane, "B": plane}, {"R": plane, "G": 0 * plane, "B": 0 * plane}):
        write_exr(tmp_path / "m.exr", channels)
        assert is_disc(open_mask(tmp_path / "m.exr"))
    write_exr(tmp_path / "m.exr", {"Y": plane + (2 * plane * disc(radius=5)).astype(dtype)})
    with pytest.raises(ValueError, match=r"m\.exr: marks several things"):
        open_mask(tmp_path / "m.exr")


@pytest.mark.parametrize("channels", [{"X": DISC, "Z": DISC}, {"Y": DISC, "Z": DISC, "A": DISC}])
def test_channels_of_which_none_is_the_mask(tmp_path, channels):
    write_exr(tmp_path / "two.exr", {name: plane.astype("f4") for name, plane in channels.items()})
    with pytest.raises(ValueError, match=r"two\.exr: expected R, G, B channels, got \["):
        open_mask(tmp_path / "two.exr")


def test_a_layer_can_be_the_mask(tmp_path):
    plane = DISC.astype("f4")
    layers = {**rgb(np.stack([1 - plane] * 3), "beauty."), **rgb(np.stack([plane] * 3), "matte.")}
    write_exr(tmp_path / "m.exr", layers)
    assert is_disc(open_mask(tmp_path / "m.exr", "matte"))


def test_values_that_are_no_numbers(tmp_path):
    plane = DISC.astype("f4")
    plane[0, 0] = np.nan
    plane[0, 1] = -5
    write_exr(tmp_path / "m.exr", {"Y": plane})
    assert is_disc(open_mask(tmp_path / "m.exr"))
    plane[0, 0] = np.inf
    write_exr(tmp_path / "m.exr", {"Y": plane})
    with pytest.raises(ValueError, match=r"m\.exr: holds infinite values; a mask is white on black$"):
        open_mask(tmp_path / "m.exr")


def test_a_mask_of_one_value(png_mask):
    assert not png_mask(np.zeros((4, 5), "u1")).marked.any()
    assert png_mask(np.full((4, 5), 255, "u1")).marked.all()


@pytest.mark.parametrize("shape", [(1, 6), (2, 6), (6, 1)])
def test_narrow_masks(png_mask, shape):
    pixels = np.array([0, 3, 250, 255, 250, 3], "u1")[: max(shape)].reshape(6, 1)
    pixels = np.broadcast_to(pixels if shape[0] == 6 else pixels.T, shape)
    assert np.array_equal(png_mask(np.ascontiguousarray(pixels)).marked[0], pixels > 100)


def test_a_speck_is_kept_for_others_to_judge(png_mask):
    pixels = DISC.astype("u1") * 255
    pixels[1, 48] = 255
    assert is_disc(png_mask(pixels), pixels > 0)


def test_a_profile_of_grey_does_not_matter(png_mask):
    profile = bytes(16) + b"GRAY" + bytes(120)
    assert is_disc(png_mask(DISC.astype("u1") * 255, chunk(b"iCCP", b"grey\0\0" + zlib.compress(profile))))


def test_what_the_file_is_not(tmp_path):
    (tmp_path / "mask.webp").touch()
    with pytest.raises(ValueError, match=r"webp: image suffix '\.webp' is not supported; use \.exr, \.hdr"):
        read_mask(tmp_path / "mask.webp")
    with pytest.raises(FileNotFoundError, match=r"mask\.png: no such file"):
        read_mask(tmp_path / "mask.png")
