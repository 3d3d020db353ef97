"""Which reader a file goes to, and what is said where there is none."""

import re

import numpy as np
import pytest
import tifffile
from PIL import Image

from picture_files import picture, png_of, rgb, write_exr
from torchbrdf.images import read_image, write_image
from torchbrdf.images.formats import read_stored

BYTES = np.zeros((4, 5, 3), "u1")
KINDS = {
    ".exr": "OpenEXR",
    ".hdr": "Radiance .hdr",
    ".jpg": "JPEG",
    ".npy": "NumPy array",
    ".pfm": "PFM",
    ".png": "PNG",
    ".tif": "TIFF",
}


def write(path) -> None:
    """A sound file of the kind that its suffix says."""
    values = picture(4, 5).numpy()
    {
        ".exr": lambda: write_exr(path, rgb(values)),
        ".hdr": lambda: write_image(path, picture(4, 5)),
        ".jpg": lambda: Image.fromarray(BYTES).save(path),
        ".npy": lambda: np.save(path, values),
        ".pfm": lambda: path.write_bytes(b"PF\n5 4\n-1\n" + values.tobytes()),
        ".png": lambda: path.write_bytes(png_of(BYTES)),
        ".tif": lambda: tifffile.imwrite(path, values.transpose(1, 2, 0), photometric="rgb"),
    }[path.suffix]()


@pytest.mark.parametrize("said", KINDS)
@pytest.mark.parametrize("true", KINDS)
def test_the_signature_must_be_that_of_the_suffix(tmp_path, true, said):
    write(tmp_path / f"true{true}")
    named = (tmp_path / f"true{true}").rename(tmp_path / f"a{said}")
    if true == said:
        assert read_stored(named).values.shape == (3, 4, 5)
        return
    message = f"{named}: is a {KINDS[true]} file, not {KINDS[said]}; name it a{true}"
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        read_stored(named)


@pytest.mark.parametrize("suffix", KINDS)
@pytest.mark.parametrize("content", [b"hello", b"\0" * 300, b"x = 3\n\n"])
def test_files_of_no_kind_give_one_line_and_print_nothing(tmp_path, capfd, suffix, content):
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(content)
    message = rf"^{re.escape(f'{path}: not a readable {KINDS[suffix]} image')} \([^\n]+\)$"
    with pytest.raises(ValueError, match=message):
        read_image(path, allow_ldr=True)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", KINDS)
def test_empty_files(tmp_path, suffix):
    (tmp_path / f"bad{suffix}").touch()
    message = rf"bad\{suffix}: is empty \(0 bytes\); expected an image \(\{suffix}\): copy or download it again$"
    with pytest.raises(ValueError, match=message):
        read_image(tmp_path / f"bad{suffix}")


def test_missing_files_folders_and_suffixes(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.exr: no such file; expected an image \(\.exr\)$"):
        read_image(tmp_path / "nothing.exr")
    with pytest.raises(FileNotFoundError, match=r"nothing: no such file; expected an image$"):
        read_image(tmp_path / "nothing")
    (tmp_path / "photo.webp").touch()
    known = r"\.exr, \.hdr, \.jpeg, \.jpg, \.npy, \.pfm, \.pic, \.png, \.tif, \.tiff"
    with pytest.raises(ValueError, match=rf"photo\.webp: image suffix '\.webp' is not supported; use {known}$"):
        read_image(tmp_path / "photo.webp")
    (tmp_path / "folder.exr").mkdir()
    with pytest.raises(IsADirectoryError, match=r"folder\.exr: is a folder; expected an image \(\.exr\)$"):
        read_image(tmp_path / "folder.exr")


def test_files_that_stand_in_for_others(tmp_path):
    path = tmp_path / "probe.hdr"
    path.write_bytes(b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 3\n")
    with pytest.raises(ValueError, match=r"probe\.hdr: is a Git LFS pointer; `git lfs pull`"):
        read_image(path)


def test_layers_are_of_openexr_alone(tmp_path):
    write(tmp_path / "a.hdr")
    message = r"a\.hdr: --layer \(layer= in Python\) is for \.exr files with several pictures; leave it out$"
    with pytest.raises(ValueError, match=message):
        read_image(tmp_path / "a.hdr", layer="beauty")
