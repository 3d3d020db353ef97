"""NumPy arrays in files."""

import numpy as np
import pytest
import torch

from picture_files import disc, picture
from torchbrdf.images import open_mask, read_image, read_picture, read_vectors
from torchbrdf.images.formats import read_stored

VALUES = picture(5, 7).numpy()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.npy"


@pytest.mark.parametrize("dtype", ["<f2", "<f4", ">f4", "<f8", "longdouble"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_channels_first_or_last(path, dtype, order):
    for axes in ((0, 1, 2), (1, 2, 0)):
        array = VALUES.transpose(axes).astype(dtype, order=order)
        np.save(path, array)
        read = read_image(path).numpy()
        assert np.array_equal(read, VALUES.astype(dtype).astype("f4"))
        assert read.flags.writeable
        assert read.flags.c_contiguous


def test_alpha(path):
    alpha = np.linspace(0, 1, 35, dtype="f4").reshape(5, 7)
    for pixels in (np.dstack([VALUES.transpose(1, 2, 0), alpha]), np.concatenate([VALUES, alpha[None]])):
        np.save(path, pixels)
        read = read_picture(path)
        assert np.array_equal(read.image, VALUES)
        assert np.array_equal(read.alpha[0], alpha)


@pytest.mark.parametrize("shape", [(3, 5, 3), (3, 7, 4), (1, 6, 3), (4, 4, 4), (3, 3, 3)])
def test_shapes_of_two_meanings(path, shape):
    np.save(path, np.ones(shape, "f4"))
    with pytest.raises(ValueError, match=r"a\.npy: has shape .*: its first or its last axis may be the channels"):
        read_image(path)


@pytest.mark.parametrize("shape", [(), (12,), (5, 7, 2), (6, 5, 7), (2, 3, 5, 7)])
def test_shapes_without_channels(path, shape):
    np.save(path, np.ones(shape, "f4"))
    with pytest.raises(ValueError, match=r"a\.npy: has shape .*; a picture needs \(H, W, 3\) or \(3, H, W\), a mask"):
        read_image(path)


def test_an_array_without_a_pixel(path):
    np.save(path, np.ones((0, 5, 3), "f4"))
    with pytest.raises(ValueError, match=r"a\.npy: not a readable NumPy array image \(shape \(0, 5, 3\)\)$"):
        read_image(path)


@pytest.mark.parametrize("dtype", ["u1", "u2", ">u2"])
def test_integers_are_taken_only_where_that_is_allowed(path, dtype):
    pixels = np.arange(90).reshape(5, 6, 3).astype(dtype)
    np.save(path, pixels)
    with pytest.raises(ValueError, match=r"a\.npy: (8|16)-bit NumPy array is not linear HDR; .* pass --allow-ldr"):
        read_image(path)
    linear = read_image(path, encoding="linear").permute(1, 2, 0)
    np.testing.assert_allclose(linear, pixels / np.iinfo(dtype).max, rtol=1e-6)


@pytest.mark.parametrize("dtype", ["?", "u1", "u2", "i4", "i8", "f4"])
@pytest.mark.parametrize("white", [1, 255])
@pytest.mark.parametrize("axes", [(), (0,), (2,)])
def test_masks(path, dtype, white, axes):
    np.save(path, np.expand_dims((disc() * white).astype(dtype), axes))
    assert np.array_equal(open_mask(path).marked[0], disc())


@pytest.mark.parametrize(("lowest", "highest"), [(-1, 3), (0, 256)])
def test_wide_integers_of_no_known_scale(path, lowest, highest):
    np.save(path, np.linspace(lowest, highest, 90).reshape(5, 6, 3).astype("i8"))
    message = rf"a\.npy: holds int64 values from {lowest} to {highest}; write floating-point ones, or uint16$"
    with pytest.raises(ValueError, match=message):
        read_image(path, allow_ldr=True)


@pytest.mark.parametrize("dtype", ["c8", "M8[s]", "U3", [("r", "f4")]])
def test_other_types(path, dtype):
    np.save(path, np.zeros((5, 6, 3), dtype))
    with pytest.raises(ValueError, match=r"a\.npy: holds values of the type .*; write floating-point ones$"):
        read_image(path)


def test_objects_are_not_unpickled(path):
    np.save(path, np.full((5, 6, 3), None), allow_pickle=True)
    with pytest.raises(ValueError, match=r"a\.npy: not a readable NumPy array image"):
        read_image(path)


def test_numbers_too_large_for_single_precision_are_infinite(path):
    np.save(path, np.full((5, 6, 3), 1e300))
    assert torch.isposinf(read_vectors(path)).all()


@pytest.mark.parametrize("place", range(8, 90, 3))
def test_damaged_headers(path, place):
    np.save(path, VALUES)
    whole = path.read_bytes()
    path.write_bytes(whole[:place] + b"(" + whole[place + 1 :])
    with pytest.raises(ValueError, match=r"a\.npy: "):
        read_stored(path)


def test_no_truncated_file_is_read(path):
    np.save(path, VALUES)
    whole = path.read_bytes()
    for length in range(1, len(whole), 3):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"a\.npy: not a readable NumPy array image"):
            read_stored(path)


def test_a_header_longer_than_the_file_is_not_asked_for(path, monkeypatch):
    path.write_bytes(b"\x93NUMPY\2\0" + (1 << 28).to_bytes(4, "little") + b"{'descr': '<f4'}")
    monkeypatch.setattr(np, "load", lambda *_, **__: pytest.fail("loaded"))
    with pytest.raises(ValueError, match=r"a\.npy: not a readable NumPy array image"):
        read_image(path)


def test_longer_headers_of_later_versions(path):
    with open(path, "wb") as file:
        np.lib.format.write_array(file, VALUES, version=(2, 0))
    assert np.array_equal(read_image(path), VALUES)


def test_types_whose_names_do_not_print_are_escaped(path):
    np.save(path, np.zeros((4, 5), [("a\x1b", "f4")]))
    with pytest.raises(ValueError, match="holds values of the type") as caught:
        read_image(path)
    assert str(caught.value).isprintable()
