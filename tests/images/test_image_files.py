"""Images in and out: exact round trips, odd files, and one-line errors for bad ones."""

import os
import re
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
import torch
from hypothesis import given, settings, strategies as st

from torchbrdf.images import png_bytes, read_image, read_mask, read_metadata, write_image
from torchbrdf.images.display import tone_map

ZIP = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}


def picture(height: int = 9, width: int = 14, seed: int = 0) -> torch.Tensor:
    return torch.rand(3, height, width, generator=torch.Generator().manual_seed(seed)) * 100


def write_channels(path: Path, channels: dict[str, np.ndarray], **header: object) -> None:
    with OpenEXR.File({**ZIP, **header}, dict(channels)) as file:
        file.write(str(path))


def window(x0: int, y0: int, x1: int, y1: int) -> tuple[np.ndarray, np.ndarray]:
    return np.array([x0, y0], "i4"), np.array([x1, y1], "i4")


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


@pytest.mark.parametrize("dtype", ["float16", "float32", "uint32"])
@pytest.mark.parametrize("extra", [(), ("A",), ("A", "Z", "depth.V")])
def test_exr_channel_types_and_extra_channels(tmp_path, dtype, extra):
    names = ("B", "R", *extra, "G")
    planes = {name: np.arange(12, dtype=dtype).reshape(3, 4) + 10 * k for k, name in enumerate(names)}
    write_channels(tmp_path / "a.exr", planes)
    read = read_image(tmp_path / "a.exr")
    for k, channel in enumerate("RGB"):
        assert torch.equal(read[k], torch.from_numpy(planes[channel].astype("f4")))


def test_exr_is_placed_in_its_display_window(tmp_path):
    pixels = picture(4, 6).numpy()
    planes = {c: np.ascontiguousarray(pixels[k]) for k, c in enumerate("RGB")}
    # The data begins 2 columns left of and 1 row below the display's corner, and ends inside.
    inside = {"dataWindow": window(3, 8, 8, 11), "displayWindow": window(5, 7, 14, 13)}
    write_channels(tmp_path / "w.exr", planes, **inside)
    read = read_image(tmp_path / "w.exr")
    expected = torch.zeros(3, 7, 10)
    expected[:, 1:5, 0:4] = torch.from_numpy(pixels)[:, :, 2:]
    assert torch.equal(read, expected)
    apart = {"dataWindow": window(3, 8, 8, 11), "displayWindow": window(20, 20, 21, 21)}
    write_channels(tmp_path / "apart.exr", planes, **apart)
    assert torch.equal(read_image(tmp_path / "apart.exr"), torch.zeros(3, 2, 2))


def test_exr_of_two_parts_gives_the_first(tmp_path):
    planes = [{c: np.full((2, 3), 10 * part + k, "f4") for k, c in enumerate("RGB")} for part in range(2)]
    parts = [OpenEXR.Part(dict(ZIP), planes[0], "a"), OpenEXR.Part(dict(ZIP), planes[1], "b")]
    with OpenEXR.File(parts) as file:
        file.write(str(tmp_path / "two.exr"))
    assert read_image(tmp_path / "two.exr")[:, 0, 0].tolist() == [0.0, 1.0, 2.0]


@given(
    scale=st.floats(-20, 20),
    values=st.lists(st.floats(0, 1, width=32), min_size=3, max_size=3),
)
@settings(deadline=None, max_examples=50)
def test_hdr_keeps_each_channel_to_one_step_of_the_brightest(tmp_path_factory, scale, values):
    path = tmp_path_factory.mktemp("hdr") / "a.hdr"
    image = (torch.tensor(values) * 2**scale)[:, None, None].expand(3, 2, 8)
    write_image(path, image)
    # A shared exponent and 8 bits: steps of 1/128 of the brightest channel at the coarsest.
    assert (read_image(path) - image).abs().max() <= image.max() / 128 + 1e-30


def test_hdr_has_no_negative_and_no_invalid_values(tmp_path):
    image = torch.tensor([-1.0, 2.0, 3.0])[:, None, None].repeat(1, 2, 8)
    image[:, 1, 0] = torch.tensor([torch.nan, torch.inf, 1.0])
    write_image(tmp_path / "a.hdr", image)
    read = read_image(tmp_path / "a.hdr")
    assert read[:, 0, 0].tolist() == [0.0, 2.0, 3.0]
    assert torch.isfinite(read).all()
    assert read[0, 1, 0] == 0
    assert read[1, 1, 0] > 1e36


def test_tone_map_is_gamma_2_2_clipped():
    values = torch.tensor([-1.0, 0.0, 0.25, 0.5, 1.0, 7.0, torch.nan, torch.inf])
    expected = torch.tensor([0.0, 0.0, 0.532521, 0.729740, 1.0, 1.0, 0.0, 1.0])
    torch.testing.assert_close(tone_map(values), expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(tone_map(values, exposure=2.0)[2], expected[3], atol=1e-5, rtol=0)


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


def test_png_is_read_only_when_allowed_and_decoded(tmp_path):
    path = tmp_path / "photo.png"
    image = picture() / 100
    write_image(path, image)
    message = (
        f"{path}: 8-bit PNG is not linear HDR; give an .exr or .hdr image, "
        "or pass --allow-ldr (allow_ldr=True in Python) to decode it with gamma 2.2"
    )
    with pytest.raises(ValueError, match=re.escape(message)):
        read_image(path)
    # Half a step of 8 bits, times the steepest slope of x^2.2.
    assert (read_image(path, allow_ldr=True) - image).abs().max() < 2.2 / 255 / 2 * 1.01


def test_png_of_16_bits_with_alpha(tmp_path):
    pixels = np.zeros((2, 3, 4), "u2")
    pixels[..., :3] = [65535, 32768, 0]  # B, G, R
    cv2.imwrite(str(tmp_path / "deep.png"), pixels)
    read = read_image(tmp_path / "deep.png", allow_ldr=True)
    torch.testing.assert_close(read[:, 1, 1], torch.tensor([0.0, 0.217645, 1.0]), atol=1e-5, rtol=0)


def test_masks(tmp_path):
    use = np.array([[True, False, True], [False, False, True]])
    expected = torch.from_numpy(use)[None]
    stacked = np.repeat(use[..., None], 4, axis=2) * np.array([255, 255, 255, 0], "u1")
    cv2.imwrite(str(tmp_path / "grey.png"), use.astype("u1") * 255)
    cv2.imwrite(str(tmp_path / "deep.png"), np.where(use, 33000, 32000).astype("u2"))
    cv2.imwrite(str(tmp_path / "alpha.png"), stacked.astype("u1"))
    write_channels(tmp_path / "single.exr", {"Y": use.astype("f4")})
    write_channels(tmp_path / "colour.exr", {c: use.astype("f2") * 0.6 for c in "RGB"})
    for path in tmp_path.iterdir():
        mask = read_mask(path)
        assert mask.dtype == torch.bool
        assert torch.equal(mask, expected), path.name


def test_mask_errors(tmp_path):
    write_channels(tmp_path / "two.exr", {"X": np.ones((2, 2), "f4"), "Z": np.ones((2, 2), "f4")})
    message = r"two\.exr: expected one channel or R, G, B for a mask, got \['X', 'Z'\]$"
    with pytest.raises(ValueError, match=message):
        read_mask(tmp_path / "two.exr")
    (tmp_path / "mask.jpg").touch()
    with pytest.raises(ValueError, match=r"jpg: image suffix '\.jpg' is not supported; use \.png, \.exr$"):
        read_mask(tmp_path / "mask.jpg")


def test_wrong_channels(tmp_path):
    write_channels(tmp_path / "grey.exr", {"Y": np.ones((2, 2), "f4")})
    with pytest.raises(ValueError, match=r"grey\.exr: expected R, G, B channels, got \['Y'\]$"):
        read_image(tmp_path / "grey.exr")
    cv2.imwrite(str(tmp_path / "grey.png"), np.ones((2, 2), "u1"))
    with pytest.raises(ValueError, match=r"grey\.png: expected R, G, B channels, got 1 channel\(s\)$"):
        read_image(tmp_path / "grey.png", allow_ldr=True)


def test_missing_folder_and_suffix(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.exr: no such file$"):
        read_image(tmp_path / "nothing.exr")
    (tmp_path / "photo.jpeg").touch()
    with pytest.raises(ValueError, match=r"suffix '\.jpeg' is not supported; use \.exr, \.hdr, \.png$"):
        read_image(tmp_path / "photo.jpeg")
    (tmp_path / "folder.exr").mkdir()
    with pytest.raises(ValueError, match=r"is a folder; expected an image file \(\.exr, \.hdr, \.png\)$"):
        read_image(tmp_path / "folder.exr")


@pytest.mark.parametrize(
    ("suffix", "kind"), [(".exr", "OpenEXR"), (".hdr", "Radiance .hdr"), (".png", "PNG")]
)
@pytest.mark.parametrize("damage", ["half", "text", "empty", "TIFF"])
def test_damaged_files_give_one_line_and_print_nothing(tmp_path, capfd, suffix, kind, damage):
    path = tmp_path / f"bad{suffix}"
    write_image(path, picture(64, 128))
    whole = path.read_bytes()
    tiff = cv2.imencode(".tif", np.zeros((4, 4, 3), "f8"))[1].tobytes()
    path.write_bytes({"half": whole[: len(whole) // 2], "text": b"hello", "empty": b"", "TIFF": tiff}[damage])
    message = f"{path}: not a readable {kind} image (truncated, damaged or another format)"
    with pytest.raises(ValueError, match=re.escape(message)) as caught:
        read_image(path, allow_ldr=True)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_a_header_that_asks_for_terabytes_is_refused(tmp_path):
    header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 900000 +X 900000\n\x02\x02"
    (tmp_path / "huge.hdr").write_bytes(header)
    with pytest.raises(ValueError, match=r"huge\.hdr: not a readable Radiance \.hdr image"):
        read_image(tmp_path / "huge.hdr")
    planes = {c: np.zeros((2, 2), "f4") for c in "RGB"}
    write_channels(tmp_path / "huge.exr", planes, displayWindow=window(0, 0, 900_000, 900_000))
    with pytest.raises(ValueError, match=r"huge\.exr: not a readable OpenEXR image"):
        read_image(tmp_path / "huge.exr")


@pytest.mark.parametrize("suffix", [".exr", ".hdr", ".png"])
def test_a_failed_write_leaves_nothing_and_keeps_the_old_file(tmp_path, monkeypatch, suffix):
    path = tmp_path / f"a{suffix}"
    write_image(path, picture())
    before = path.read_bytes()

    def full_disk(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full_disk)
    with pytest.raises(OSError, match="No space left"):
        write_image(path, picture(seed=1))
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_bad_writes(tmp_path):
    with pytest.raises(FileNotFoundError, match="cannot write here"):
        write_image(tmp_path / "nowhere" / "a.exr", picture())
    with pytest.raises(ValueError, match=r"suffix '\.tif' is not supported; use \.exr, \.hdr, \.png$"):
        write_image(tmp_path / "a.tif", picture())
    with pytest.raises(ValueError, match=r"^image must be \(3, H, W\), got \(1, 9, 14\)$"):
        write_image(tmp_path / "a.exr", picture()[:1])
    with pytest.raises(ValueError, match=r"^image must be \(3, H, W\), got \(9, 14, 3\)$"):
        png_bytes(picture().permute(1, 2, 0))
    assert not list(tmp_path.iterdir())


def test_exr_metadata_round_trip(tmp_path):
    metadata = {"material": "grün, {\"a\": 1}\nsecond line", "empty": "", "k" * 31: "v" * 10_000}
    write_image(tmp_path / "a.exr", picture(), metadata)
    assert read_metadata(tmp_path / "a.exr") == metadata
    assert torch.equal(read_image(tmp_path / "a.exr"), picture())
    write_image(tmp_path / "plain.exr", picture())
    assert read_metadata(tmp_path / "plain.exr") == {}


def test_metadata_of_other_programs_is_text_only(tmp_path):
    planes = {c: np.zeros((2, 2), "f4") for c in "RGB"}
    write_channels(tmp_path / "a.exr", planes, owner="someone", expTime=0.25, name="part")
    assert read_metadata(tmp_path / "a.exr") == {"owner": "someone"}


@pytest.mark.parametrize(
    ("name", "metadata", "message"),
    [
        ("a.png", {"a": "b"}, r"a\.png: only \.exr files hold metadata; write an \.exr, or leave the metadata out$"),
        ("a.exr", {"type": "b"}, r"^metadata must not be named 'type', which OpenEXR keeps for itself; choose another"),
        ("a.exr", {"": "b"}, r"^metadata needs names of 1 to 31 characters and no zero bytes, got '': 'b'$"),
        ("a.exr", {"k" * 32: "b"}, "^metadata needs names of 1 to 31 characters"),
        ("a.exr", {"a": "b\0c"}, "no zero bytes"),
        ("a.exr", {"a": 3}, "^metadata must be text by name, got 'a': 3$"),
    ],
)
def test_bad_metadata(tmp_path, name, metadata, message):
    with pytest.raises(ValueError, match=message):
        write_image(tmp_path / name, picture(), metadata)
    assert not list(tmp_path.iterdir())


def test_metadata_of_bad_files(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.exr: no such file$"):
        read_metadata(tmp_path / "nothing.exr")
    (tmp_path / "bad.exr").write_bytes(b"hello")
    with pytest.raises(ValueError, match=r"bad\.exr: not a readable OpenEXR image"):
        read_metadata(tmp_path / "bad.exr")
    write_image(tmp_path / "a.hdr", picture())
    with pytest.raises(ValueError, match=r"a\.hdr: image suffix '\.hdr' is not supported; use \.exr$"):
        read_metadata(tmp_path / "a.hdr")
