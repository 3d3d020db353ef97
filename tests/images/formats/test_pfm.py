"""Portable float maps."""

import cv2
import numpy as np
import pytest
import torch

from picture_files import disc, picture
from torchbrdf.images import open_mask, read_image
from torchbrdf.images.formats import read_stored

VALUES = picture(5, 7).permute(1, 2, 0).numpy()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.pfm"


def pfm(pixels: np.ndarray, scale: str = "-1.0", end: str = "\n") -> bytes:
    kind = "PF" if pixels.ndim == 3 else "Pf"
    head = end.join([kind, f"{pixels.shape[1]} {pixels.shape[0]}", scale, ""])
    return head.encode() + pixels[::-1].astype("<f4" if scale.startswith("-") else ">f4").tobytes()


@pytest.mark.parametrize("scale", ["-1.0", "1", "-1", "1.000000", "-1e0"])
@pytest.mark.parametrize("end", ["\n", "\r\n", " \n"])
def test_both_orders_of_bytes(path, scale, end):
    path.write_bytes(pfm(VALUES, scale, end))
    assert np.array_equal(read_image(path).permute(1, 2, 0), VALUES)


def test_files_of_another_writer(path):
    cv2.imwrite(str(path), VALUES[..., ::-1])
    assert np.array_equal(read_image(path).permute(1, 2, 0), VALUES)


def test_grey(path):
    path.write_bytes(pfm(disc().astype("f4")))
    assert np.array_equal(open_mask(path).marked[0], disc())
    with pytest.raises(ValueError, match=r"a\.pfm: expected R, G, B channels, got one of grey$"):
        read_image(path)


@pytest.mark.parametrize("scale", ["2.0", "-0.5", "0"])
def test_scales_that_programs_read_in_different_ways(path, scale):
    path.write_bytes(pfm(VALUES, scale))
    with pytest.raises(ValueError, match=rf"a\.pfm: its scale {float(scale):g} is a factor to some .*; write 1 or -1$"):
        read_image(path)


def test_no_truncated_file_is_read(path):
    whole = pfm(VALUES)
    for length in range(1, len(whole), 3):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"a\.pfm: not a readable PFM image"):
            read_stored(path)


@pytest.mark.parametrize("head", ["900000 900000\n-1\n", "0 5\n-1\n", "5\n-1\n", "1 1\n1e-e\n", "1 1\nx\n"])
def test_headers_that_cannot_be_meant(path, head):
    path.write_bytes(b"PF\n" + head.encode() + bytes(100))
    with pytest.raises(ValueError, match=r"a\.pfm: not a readable PFM image"):
        read_image(path)


def test_values_can_be_written_to(path):
    path.write_bytes(pfm(np.ones((1, 3), "f4")))
    assert read_stored(path).values.flags.writeable
    path.write_bytes(pfm(VALUES))
    assert torch.isfinite(read_image(path).add_(1)).all()
