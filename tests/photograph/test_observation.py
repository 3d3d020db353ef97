"""Averages of a photograph over the pixels of a view: exact boxes, typed messages."""

import pytest
import torch

from torchbrdf.photograph.observation import observe
from torchbrdf.photograph.silhouette import Circle, find_circle
from torchbrdf.view.sphere import SphereView


def test_a_photograph_of_the_views_own_size_is_used_as_it_is():
    image = torch.rand(3, 32, 32, generator=torch.Generator().manual_seed(0))
    observed = observe(image, find_circle((32, 32)))
    assert torch.equal(observed.mask, SphereView(32).mask)
    assert torch.allclose(observed.image, torch.where(observed.mask, image, 0))


def test_averages_are_over_areas():
    """A square of 60.4 pixels at (11.1, 3.5) onto 4 x 4: boxes of 151 pixels of the ten times finer image."""
    image = torch.rand(3, 70, 90, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    observed = observe(image, Circle(41.3, 33.7, 30.2), size=4)
    fine = image.repeat_interleave(10, 1).repeat_interleave(10, 2)[:, 35 : 35 + 604, 111 : 111 + 604]
    expected = torch.nn.functional.avg_pool2d(fine, 151)
    assert int(observed.mask.sum()) == 4
    assert torch.allclose(observed.image, torch.where(observed.mask, expected, 0), rtol=1e-9)


def test_a_masked_pixel_takes_out_every_new_pixel_that_it_touches():
    mask = torch.ones(1, 64, 64, dtype=torch.bool)
    mask[0, 20, 21] = False
    observed = observe(torch.ones(3, 64, 64), find_circle((64, 64)), mask, size=16)
    assert torch.equal(torch.nonzero(SphereView(16).mask & ~observed.mask), torch.tensor([[0, 5, 5]]))


def test_not_finite_pixels_harm_only_where_they_are_used():
    image = torch.ones(3, 32, 32)
    image[:, 0, 0] = float("nan")
    assert torch.isfinite(observe(image, find_circle((32, 32))).image).all()
    image[0, 16, 16] = float("inf")
    with pytest.raises(ValueError, match="NaN or infinite values in 1 of the 32 x 32 pixels; mask them out"):
        observe(image, find_circle((32, 32)))


def test_a_black_ball():
    with pytest.raises(ValueError, match="the ball is black: every usable pixel is 0"):
        observe(torch.zeros(3, 16, 16), find_circle((16, 16)))
