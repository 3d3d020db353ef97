"""Vectors from files: numbers as they are stored."""

import numpy as np
import pytest
import torch

from picture_files import picture, png_of, rgb, write_exr
from torchbrdf.images import read_vectors
from torchbrdf.images.primaries import SPACES


def test_numbers_are_as_they_are_stored_whatever_colours_the_file_names(tmp_path):
    values = picture().numpy() - 50
    write_exr(tmp_path / "a.exr", rgb(values), chromaticities=sum(SPACES["aces-ap0"].values, ()))
    assert np.array_equal(read_vectors(tmp_path / "a.exr"), values)
    np.save(tmp_path / "a.npy", values)
    assert np.array_equal(read_vectors(tmp_path / "a.npy"), values)


def test_integers_are_over_their_full_scale(tmp_path):
    pixels = np.arange(18, dtype="u2").reshape(2, 3, 3) * 3000
    (tmp_path / "a.png").write_bytes(png_of(pixels))
    expected = torch.from_numpy(pixels / 65535).permute(2, 0, 1).float()
    torch.testing.assert_close(read_vectors(tmp_path / "a.png"), expected)


def test_one_number_a_pixel_is_no_vector(tmp_path):
    write_exr(tmp_path / "a.exr", {"Y": np.ones((2, 2), "f4")})
    with pytest.raises(ValueError, match=r"a\.exr: expected channels X, Y, Z or R, G, B, got one of grey$"):
        read_vectors(tmp_path / "a.exr")
