"""Finding the ball and averaging its square: exact boxes, known circles, typed messages."""

import pytest
import torch

from torchbrdf.photograph.observation import observe
from torchbrdf.photograph.silhouette import Circle, find_circle
from torchbrdf.view.sphere import SphereView


def disc(height: int, width: int, x: float, y: float, radius: float) -> torch.Tensor:
    rows, columns = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    return ((columns - x) ** 2 + (rows - y) ** 2 <= radius**2)[None]


def test_without_a_mask_the_ball_is_the_inscribed_circle():
    assert find_circle((40, 60)) == Circle(30.0, 20.0, 20.0)


@pytest.mark.parametrize(("x", "y", "radius"), [(50.0, 40.0, 30.0), (33.3, 47.7, 21.4)])
def test_circle_from_a_mask_is_within_a_third_of_a_pixel(x, y, radius):
    found = find_circle((90, 110), disc(90, 110, x, y, radius))
    assert (found.x, found.y, found.radius) == pytest.approx((x, y, radius), abs=1 / 3)


def test_holes_and_a_missing_stand_do_not_move_the_circle():
    mask = disc(90, 110, 50.0, 40.0, 30.0)
    whole = find_circle((90, 110), mask)
    mask[:, 30:40, 45:60] = False
    mask[:, 60:, 40:60] = False
    found = find_circle((90, 110), mask)
    assert (found.x, found.y, found.radius) == pytest.approx((whole.x, whole.y, whole.radius), abs=0.3)


def test_a_mask_of_uncut_pixels_means_the_inscribed_circle():
    assert find_circle((64, 64), SphereView(64).mask) == Circle(32.0, 32.0, 32.0)


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


def test_messages_for_bad_masks_and_black_balls():
    with pytest.raises(ValueError, match="mask is empty: no pixel is marked as usable"):
        find_circle((8, 8), torch.zeros(1, 8, 8, dtype=torch.bool))
    with pytest.raises(ValueError, match="mask must have the size of the photograph, 8 x 8, got 8 x 9"):
        find_circle((8, 8), torch.ones(1, 8, 9, dtype=torch.bool))
    with pytest.raises(ValueError, match="the ball is black: every usable pixel is 0"):
        observe(torch.zeros(3, 16, 16), find_circle((16, 16)))
    with pytest.raises(ValueError, match="at least 3 pixels across"):
        Circle(4.0, 4.0, 1.0)
