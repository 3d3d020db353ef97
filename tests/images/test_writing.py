"""Images to files: exact round trips, and files that are whole or absent."""

import os
import sys

import cv2
import numpy as np
import OpenEXR
import pytest
import torch
from hypothesis import given, settings, strategies as st

from picture_files import picture
from torchbrdf.images import png_bytes, read_image, read_metadata, write_image
from torchbrdf.images.display import tone_map


def test_exr_round_trip_is_exact_also_for_strided_tensors(tmp_path):
    image = picture()
    for name, given_image in {
        "plain.exr": image,
        "UPPER.EXR": image,
        "strided.exr": torch.rand(14, 9, 3).permute(2, 1, 0),
        "flipped.exr": image.flip(2)[:, ::2, ::3],
        "double.exr": image.double(),
        "gradient.exr": image.clone().requires_grad_(),
    }.items():
        write_image(tmp_path / name, given_image)
        read = read_image(tmp_path / name)
        assert read.dtype == torch.float32
        assert torch.equal(read, given_image.detach().float()), name
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
@pytest.mark.parametrize("suffix", ["exr", "hdr"])
def test_a_name_that_is_no_text(tmp_path, suffix):
    path = tmp_path / os.fsdecode(b"r\xe9.") / f"b\udce9.{suffix}"
    path.parent.mkdir()
    write_image(path, torch.ones(3, 4, 5))
    assert torch.equal(read_image(path), torch.ones(3, 4, 5))
    assert os.listdir(os.fsencode(path.parent)) == [b"b\xe9." + suffix.encode()]
    if suffix == "exr":
        assert read_metadata(path) == {}


@given(
    scale=st.floats(-20, 20),
    values=st.lists(st.floats(0, 1, width=32), min_size=3, max_size=3),
)
@settings(deadline=None, max_examples=50)
def test_hdr_keeps_each_channel_to_half_a_step_of_the_brightest(tmp_path_factory, scale, values):
    path = tmp_path_factory.mktemp("hdr") / "a.hdr"
    image = (torch.tensor(values) * 2**scale)[:, None, None].expand(3, 2, 8)
    write_image(path, image)
    # A shared exponent and 8 bits: half steps of 1/256 of the brightest channel at the coarsest, or 1/255.5 where
    # rounding takes it to the next exponent.
    assert (read_image(path) - image).abs().max() <= image.max() / 255.5 + 1e-30


@given(exponent=st.integers(-95, 114), mantissas=st.tuples(*[st.integers(0, 255)] * 2))
@settings(deadline=None, max_examples=50)
def test_what_rgbe_holds_is_kept_to_the_bit(tmp_path_factory, exponent, mantissas):
    path = tmp_path_factory.mktemp("hdr") / "a.hdr"
    brightest = torch.arange(128, 256)
    image = torch.stack([brightest, *(torch.tensor(m).expand(128).minimum(brightest) for m in mantissas)])
    image = torch.ldexp(image.float(), torch.tensor(exponent))[:, None]
    write_image(path, image)
    assert torch.equal(read_image(path), image)


@pytest.mark.parametrize("colour", [(1.0, 1.0, 1.0), (1.0, 0.6, 0.2)])
def test_hdr_is_as_bright_on_average(tmp_path, colour):
    """Within three deviations of what rounding spreads; cut off, means were darker by 0.27 and 0.5 %."""
    grey = torch.rand(1, 100, 100, generator=torch.Generator().manual_seed(0)) * 4 + 0.1
    image = grey * torch.tensor(colour)[:, None, None]
    write_image(tmp_path / "a.hdr", image)
    ratio = read_image(tmp_path / "a.hdr").mean((1, 2)) / image.mean((1, 2))
    assert (ratio - 1).abs().max() < 4 * 3 / 256 / 12**0.5 / 100 / min(colour) / float(grey.mean())


def test_hdr_has_no_negative_and_no_invalid_values(tmp_path):
    image = torch.tensor([-1.0, 2.0, 3.0])[:, None, None].repeat(1, 2, 8)
    image[:, 1, 0] = torch.tensor([torch.nan, torch.inf, 1.0])
    write_image(tmp_path / "a.hdr", image)
    read = read_image(tmp_path / "a.hdr")
    assert read[:, 0, 0].tolist() == [0.0, 2.0, 3.0]
    assert torch.isfinite(read).all()
    assert read[0, 1, 0] == 0
    assert read[1, 1, 0] > 1e36


def test_png_is_the_tone_mapped_image(tmp_path):
    image = picture() / 60
    image[:, 0, 0] = torch.tensor([1.0, 0.5, 0.0])
    write_image(tmp_path / "a.PNG", image)
    assert (tmp_path / "a.PNG").read_bytes() == png_bytes(image)
    pixels = cv2.imread(str(tmp_path / "a.PNG"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    assert pixels[0, 0].tolist() == [255, 186, 0]
    expected = (tone_map(image) * 255).round().permute(1, 2, 0).numpy().astype("u1")
    assert np.array_equal(pixels, expected)
    assert png_bytes(image, exposure=0.5) == png_bytes(image * 0.5)


@pytest.mark.parametrize("suffix", [".exr", ".hdr", ".png", ".jpg"])
def test_a_failed_write_leaves_nothing_and_keeps_the_old_file(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"a{suffix}"
    write_image(path, picture())
    before = path.read_bytes()

    def full_disk(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full_disk)
    with pytest.raises(OSError, match="it is full; make room there"):
        write_image(path, picture(seed=1))
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_bad_writes(tmp_path):
    with pytest.raises(FileNotFoundError, match="cannot write here"):
        write_image(tmp_path / "nowhere" / "a.exr", picture())
    with pytest.raises(ValueError, match=r"suffix '\.tif' is not supported; use \.exr, \.hdr, \.png, \.jpg, \.jpeg$"):
        write_image(tmp_path / "a.tif", picture())
    with pytest.raises(ValueError, match=r"^image must be \(3, H, W\), got \(1, 9, 14\)$"):
        write_image(tmp_path / "a.exr", picture()[:1])
    with pytest.raises(ValueError, match=r"^image must be \(3, H, W\), got \(9, 14, 3\)$"):
        png_bytes(picture().permute(1, 2, 0))
    assert not list(tmp_path.iterdir())


def test_exr_metadata_round_trip(tmp_path):
    metadata = {"material": 'grün, {"a": 1}\nsecond line', "empty": "", "k" * 31: "v" * 10_000}
    write_image(tmp_path / "a.exr", picture(), metadata)
    assert read_metadata(tmp_path / "a.exr") == metadata
    assert torch.equal(read_image(tmp_path / "a.exr"), picture())
    write_image(tmp_path / "plain.exr", picture())
    assert read_metadata(tmp_path / "plain.exr") == {}


def test_exr_keeps_numbers_and_pixels_that_are_none(tmp_path):
    image = picture()
    image[:, 2, 3] = torch.nan
    write_image(tmp_path / "a.exr", image, {"nominalFocalLength": 50.0, "owner": "someone"})
    assert OpenEXR.File(str(tmp_path / "a.exr")).header()["nominalFocalLength"] == 50.0
    assert read_metadata(tmp_path / "a.exr") == {"owner": "someone"}
    assert torch.equal(torch.isnan(read_image(tmp_path / "a.exr")), torch.isnan(image))


@pytest.mark.parametrize(
    ("name", "metadata", "message"),
    [
        ("a.png", {"a": "b"}, r"a\.png: only \.exr files hold metadata; write an \.exr, or leave the metadata out$"),
        ("a.exr", {"type": "b"}, r"^metadata must not be named 'type', which OpenEXR keeps for itself; choose another"),
        ("a.exr", {"": "b"}, r"^metadata needs names of 1 to 31 characters and no zero bytes, got '': 'b'$"),
        ("a.exr", {"k" * 32: "b"}, "^metadata needs names of 1 to 31 characters"),
        ("a.exr", {"a": "b\0c"}, "no zero bytes"),
        ("a.exr", {"a": [3]}, r"^metadata must be text or numbers by name, got 'a': \[3\]$"),
    ],
)
def test_bad_metadata(tmp_path, name, metadata, message):
    with pytest.raises(ValueError, match=message):
        write_image(tmp_path / name, picture(), metadata)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".exr", ".hdr"])
@pytest.mark.parametrize("space", ["rec2020", "aces-ap1", "rec709"])
def test_the_colour_space_is_named(tmp_path, suffix, space):
    image = picture().clamp_min(5)
    write_image(tmp_path / f"a{suffix}", image, primaries=space)
    read = read_image(tmp_path / f"a{suffix}", primaries=space)
    assert (read - image).abs().max() <= (0 if suffix == ".exr" else image.max() / 128)
    if space != "rec709":
        assert (read_image(tmp_path / f"a{suffix}") - image).abs().max() > 1


def test_a_png_is_rec_709_for_screens(tmp_path):
    """A colour that Rec. 2020 has in its own numbers, and grey, which is the same."""
    image = torch.tensor([[0.6, 0.5], [0.5, 0.5], [0.4, 0.5]])[:, None]
    write_image(tmp_path / "a.png", image, primaries="rec2020")
    write_image(tmp_path / "b.png", image)
    wide, plain = (read_image(tmp_path / name, allow_ldr=True)[:, 0] for name in ("a.png", "b.png"))
    assert wide[0, 0] - wide[2, 0] > 1.2 * (plain[0, 0] - plain[2, 0])
    torch.testing.assert_close(wide[:, 1], plain[:, 1])


@pytest.mark.parametrize(
    ("name", "more", "said"),
    [
        ("a.hdr", {"alpha": torch.ones(1, 9, 14)}, "only .exr files hold alpha and envmap; write an .exr"),
        ("a.png", {"envmap": "cube"}, "only .exr files hold alpha and envmap; write an .exr"),
        ("a.exr", {"alpha": torch.ones(9, 14)}, r"alpha must be \(1, 9, 14\), as the image is, got \(9, 14\)"),
        ("a.exr", {"envmap": "ball"}, "envmap must be one of latlong, cube, got 'ball'"),
    ],
)
def test_what_is_beside_the_colours_is_checked(tmp_path, name, more, said):
    with pytest.raises(ValueError, match=said):
        write_image(tmp_path / name, picture(), **more)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.exr", "a.hdr", "a.png"])
def test_colours_of_a_space_that_is_none(tmp_path, name):
    message = r"^primaries must be one of rec709, rec2020, p3-d65, aces-ap0, aces-ap1, xyz, got 'srgb'$"
    with pytest.raises(ValueError, match=message):
        write_image(tmp_path / name, picture(), primaries="srgb")
    assert not list(tmp_path.iterdir())


def test_metadata_of_whole_numbers(tmp_path):
    numbers = {"iso": 100, "least": -(2**31), "largest": 2**31 - 1, "stops": 1.5}
    write_image(tmp_path / "a.exr", picture(), numbers)
    with OpenEXR.File(str(tmp_path / "a.exr")) as file:
        assert {key: file.header()[key] for key in numbers} == numbers
    for value in (2**31, -(2**31) - 1):
        message = rf"^metadata holds whole numbers of 32 bits, got 'iso': {value}; give it as text$"
        with pytest.raises(ValueError, match=message):
            write_image(tmp_path / "b.exr", picture(), {"iso": value})
    assert not (tmp_path / "b.exr").exists()
