"""A photograph and its mask from files: what may be used, and what is said of it."""

import numpy as np
import pytest
import torch

from discs import disc
from picture_files import window, write_exr
from torchbrdf.images import Window, write_image
from torchbrdf.photograph.photograph import Photograph

BALL = disc(30, 40, 24, 15, 9)


def write(path, alpha=None, **header):
    """A picture that tells its pixels apart."""
    planes = {name: np.arange(1200, dtype="f4").reshape(30, 40) + k for k, name in enumerate("RGB")}
    if alpha is not None:
        planes["A"] = alpha.astype("f4")
    write_exr(path, planes, **header)
    return path


@pytest.fixture
def mask(tmp_path):
    write_image(tmp_path / "mask.png", BALL.expand(3, -1, -1).float())
    return tmp_path / "mask.png"


def test_a_photograph_alone_is_used_whole(tmp_path):
    found = Photograph.open(write(tmp_path / "a.exr"))
    assert found.mask is None
    assert found.window is None
    assert found.usable.all()
    assert found.about == ()


def test_a_mask_marks_what_is_used(tmp_path, mask):
    found = Photograph.open(write(tmp_path / "a.exr"), mask)
    assert torch.equal(found.mask, BALL)
    assert torch.equal(found.usable, BALL)
    assert torch.equal(Photograph.open(tmp_path / "a.exr", mask, invert_mask=True).mask, ~BALL)


def test_alpha_is_the_mask_where_none_is_given(tmp_path, mask):
    path = write(tmp_path / "a.exr", 1 - BALL[0].numpy())
    found = Photograph.open(path)
    assert torch.equal(found.mask, ~BALL)
    assert found.about == ("its alpha is the mask",)
    assert torch.equal(Photograph.open(path, mask).mask, BALL)


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_alpha_that_tells_nothing_is_no_mask(tmp_path, value):
    found = Photograph.open(write(tmp_path / "a.exr", np.full((30, 40), value)))
    assert found.mask is None
    assert found.about == ()


def test_what_was_not_recorded_is_not_used(tmp_path, mask):
    corners = {"displayWindow": window(0, 0, 49, 59), "dataWindow": window(5, 20, 44, 49)}
    found = Photograph.open(write(tmp_path / "a.exr", **corners))
    assert found.image.shape == (3, 60, 50)
    assert found.window == Window(5, 20, 40, 30)
    assert torch.equal(found.usable, torch.isfinite(found.image[:1]))
    assert found.usable.sum() == 1200
    assert found.about == ("recorded 30 x 40 of its pixels",)


def test_pixels_that_no_exposure_holds_are_not_used(tmp_path, mask):
    image = torch.ones(3, 30, 40)
    image[1, 15, 24] = image[:, 0, :2] = torch.nan
    image[0, 15, 23] = torch.inf
    write_image(tmp_path / "a.exr", image)
    found = Photograph.open(tmp_path / "a.exr", mask)
    assert torch.equal(found.usable, BALL & torch.isfinite(image).all(0))
    assert found.about == (
        "left out 1 pixels that are infinite (too bright)",
        "left out 1 pixels that are not a number",
    )


def test_sizes_must_agree(tmp_path, mask):
    write_image(tmp_path / "small.exr", torch.ones(3, 30, 39))
    message = r"mask\.png: mask must have the size of the photograph, 30 x 39, got 30 x 40$"
    with pytest.raises(ValueError, match=message):
        Photograph.open(tmp_path / "small.exr", mask)


def test_nothing_to_invert(tmp_path):
    with pytest.raises(ValueError, match=r"^--invert-mask needs a mask: give --mask$"):
        Photograph.open(write(tmp_path / "a.exr"), invert_mask=True)
