"""Where the ball is: known circles, masks that are none, and what is said of guesses."""

import warnings

import pytest
import torch

from discs import disc
from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.images import Window
from torchbrdf.photograph.silhouette import Circle, find_ball, find_circle
from torchbrdf.view.sphere import SphereView

SIZES = [12, 30, 100]


@pytest.fixture(autouse=True)
def no_warnings():
    """Unless a test expects them."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def ball(radius: float) -> torch.Tensor:
    """With half a radius of room around it."""
    side = round(3 * radius)
    return disc(side, side, 1.5 * radius, 1.4 * radius, radius)


def close(found: Circle, x: float, y: float, radius: float, tolerance: float = 0.6) -> bool:
    """Pixels' centres reach to half a pixel and a diagonal's part of the rim."""
    return found.differs(Circle(x, y, radius)) < tolerance


def test_without_a_mask_the_ball_is_the_inscribed_circle():
    assert find_circle((40, 40)) == Circle(20.0, 20.0, 20.0)
    assert find_circle((40, 41)) == Circle(20.5, 20.0, 20.0)


def test_without_a_mask_an_oblong_photograph_is_a_guess():
    with pytest.warns(UserWarning, match="^no mask: the ball is taken to fill the middle of the 40 x 60 photograph$"):
        assert find_circle((40, 60)) == Circle(30.0, 20.0, 20.0)


@pytest.mark.parametrize(("x", "y", "radius"), [(50.0, 40.0, 30.0), (33.3, 47.7, 21.4)])
def test_circle_from_a_mask_is_within_a_third_of_a_pixel(x, y, radius):
    assert close(find_circle((90, 110), disc(90, 110, x, y, radius)), x, y, radius, 1 / 3)


def test_holes_and_a_missing_stand_do_not_move_the_circle():
    mask = disc(90, 110, 50.0, 40.0, 30.0)
    whole = find_circle((90, 110), mask)
    mask[:, 30:40, 45:60] = False
    mask[:, 60:, 40:60] = False
    assert find_circle((90, 110), mask).differs(whole) < 0.3


def test_a_mask_of_uncut_pixels_means_the_inscribed_circle():
    assert find_circle((64, 64), SphereView(64).mask) == Circle(32.0, 32.0, 32.0)


@pytest.mark.parametrize("radius", SIZES)
def test_stray_pixels_do_not_move_it(radius):
    mask = ball(radius)
    whole = find_circle(mask.shape[1:], mask)
    mask[0, -1, -1] = mask[0, -1, 0] = True
    assert find_circle(mask.shape[1:], mask) == whole


@pytest.mark.parametrize("radius", SIZES)
def test_a_rod_before_the_ball_leaves_two_parts_of_one_circle(radius):
    mask = ball(radius)
    mask[:, :, round(1.4 * radius) : round(1.6 * radius)] = False
    assert close(find_circle(mask.shape[1:], mask), 1.5 * radius, 1.4 * radius, radius)


@pytest.mark.parametrize("radius", SIZES)
def test_half_a_ball_is_uncertain(radius):
    mask = ball(radius)
    mask[:, round(1.4 * radius) :] = False
    with pytest.warns(UserWarning, match=r"^the mask fills 5.% of its circle at .* of the rim: the silhouette may be "):
        find_circle(mask.shape[1:], mask)


def test_a_second_ball_is_said():
    two = disc(90, 180, 45, 45, 30) | disc(90, 180, 130, 45, 20)
    with pytest.warns(UserWarning, match=r"^31% of the mask lie beside its largest part, a circle at \(45"):
        assert close(find_circle((90, 180), two), 45, 45, 30)


def test_a_ball_that_one_side_of_the_photograph_cuts_is_one():
    assert close(find_circle((60, 90), disc(60, 90, 45, 18, 30)), 45, 18, 30)


@pytest.mark.parametrize("radius", SIZES)
def test_an_inverted_mask_is_told_from_others(radius):
    mask = ~ball(radius)
    with pytest.raises(ValueError, match=r"^the mask marks what lies around a ball, circle at .* give --invert-mask"):
        find_circle(mask.shape[1:], mask)


@pytest.mark.parametrize("mask", [torch.ones(1, 60, 90, dtype=torch.bool), disc(60, 90, 45, 30, 50)])
def test_no_ball_leaves_the_photograph_on_opposite_sides(mask):
    message = r"^the mask's silhouette, a circle at \(45.*, leaves the photograph on opposite sides; mark the ball "
    with pytest.raises(ValueError, match=message):
        find_circle((60, 90), mask)


def test_a_patch_of_the_ball_is_no_silhouette():
    mask = torch.zeros(1, 300, 300, dtype=torch.bool)
    mask[:, 90:190, 100:200] = True
    with pytest.raises(ValueError, match=r"and follows 7% of the rim: it marks no ball; mark all of it, or give its "):
        find_circle((300, 300), mask)


@pytest.mark.parametrize(
    ("window", "expected"),
    [
        (Window(90, 50, 64, 64), Circle(122, 82, 32)),  # a crop to the ball
        (Window(26, 1, 148, 148), Circle(100, 75, 75)),  # what a program left after it cut black borders
        (Window(0, 0, 200, 150), Circle(100, 75, 75)),
    ],
)
def test_what_was_recorded_is_the_picture(window, expected):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert find_circle((150, 200), window=window) == expected


def test_an_oblong_part_that_was_recorded_is_a_guess():
    with pytest.warns(UserWarning, match="^no mask: the ball is taken to fill the 40 x 64 pixels recorded$"):
        assert find_circle((150, 200), window=Window(90, 50, 64, 40)) == Circle(122, 70, 20)


def test_messages_for_bad_masks():
    with pytest.raises(ValueError, match="mask is empty: no pixel is marked as usable"):
        find_circle((8, 8), torch.zeros(1, 8, 8, dtype=torch.bool))
    with pytest.raises(ValueError, match="mask must have the size of the photograph, 8 x 8, got 8 x 9"):
        find_circle((8, 8), torch.ones(1, 8, 9, dtype=torch.bool))
    with pytest.raises(ValueError, match="at least 3 pixels across"):
        Circle(4.0, 4.0, 1.0)


CAMERA = PinholeCamera.of_fov((160, 240), 50)


def mask_of(ball: Ball) -> torch.Tensor:
    """(1, H, W): the pixels whose centres the ball covers."""
    y, x = (torch.arange(n, dtype=torch.float64) + 0.5 for n in ball.camera.size)
    return ball.contains(torch.stack(torch.broadcast_tensors(x, y[:, None]), -1))[None]


def test_the_ball_of_a_mask_off_the_axis():
    """A circle around its ellipse would be 1.5 pixels too wide."""
    ball = Ball.of_circle(CAMERA, 180, 50, 30)
    assert find_ball(CAMERA, mask_of(ball)).circle == pytest.approx((180, 50, 30), abs=0.4)


@pytest.mark.parametrize(("fov_deg", "size"), [(0.3, 96), (1, 96), (3, 96), (24, 1600)])
def test_the_ball_of_a_mask_that_fills_a_narrow_cone(fov_deg: float, size: int):
    """As well as in a wide one."""
    camera = PinholeCamera.of_fov((size, size), fov_deg)
    middle = size / 2 + 0.3
    ball = find_ball(camera, mask_of(Ball.of_circle(camera, middle, middle, 32)))
    assert ball.circle == pytest.approx((middle, middle, 32), abs=0.05)


def test_a_ball_that_fills_the_photograph_is_on_the_axis():
    camera = PinholeCamera.of_fov((64, 64), 24)
    ball = find_ball(camera)
    assert ball.direction == pytest.approx((0, 0, -1), abs=1e-9)
    assert ball.fov_deg == pytest.approx(24)
