"""Which ball is meant, and what is said where that is not clear."""

import warnings

import pytest
import torch

from photographs_of_balls import off, photographed
from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.images import Window
from torchbrdf.photograph import Circle, another, choice, locate
from torchbrdf.photograph._pyramid import Pyramid

SIZE = (160, 240)
LARGE, SMALL = Circle(80.0, 72.6, 38.4), Circle(190.0, 100.0, 25.0)


@pytest.fixture(scope="module", autouse=True)
def found_once():
    """What is found in one photograph for one camera, which takes a second, is looked for once."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("balls_of", "any_sure"):
            patch.setattr(choice, name, remembered(getattr(choice, name)))
        patch.setattr(choice, "find_balls", lambda image, camera: choice.balls_of(Pyramid.of(image), camera))
        yield


def remembered(find):
    """The same function of a pyramid and a camera, called once for each."""
    known = {}

    def found(pyramid, *camera):
        key = pyramid.levels[0].shape, pyramid.levels[0].tobytes(), camera
        if key not in known:
            known[key] = find(pyramid, *camera)
        return known[key]

    return found


@pytest.fixture(autouse=True)
def no_warnings():
    """Unless a test expects them."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def test_the_largest_is_taken_and_that_is_said():
    silhouette, told = locate(photographed(SIZE, [SMALL, LARGE]))
    assert off(silhouette, LARGE) < 0.15
    assert told.startswith("ball 1 of 2 found, to 0.")


def test_another_by_its_number():
    silhouette, told = locate(photographed(SIZE, [SMALL, LARGE]), number=2)
    assert off(silhouette, SMALL) < 0.3
    assert told.startswith("ball 2 of 2 found")


def test_a_number_that_is_none():
    with pytest.raises(
        ValueError, match=r"^--ball 3 is not among the balls found, 1: circle at \(80\.0, 72\.\d\), rad"
    ):
        locate(photographed(SIZE, [SMALL, LARGE]), number=3)


def test_two_of_like_size_need_a_number():
    image = photographed(SIZE, [LARGE, Circle(190.0, 100.0, 37.0)])
    with pytest.raises(
        ValueError, match=r"^several balls of like size are found, 1: circle .*; 2: circle .*: --ball N$"
    ):
        locate(image)
    assert off(locate(image, number=1)[0], LARGE) < 0.15


def test_no_ball():
    with pytest.raises(
        ValueError, match=r"^no ball is found; off the middle .* --fov\. To use one, give its place, --circle X"
    ):
        locate(photographed(SIZE, []))


def test_a_ball_of_which_too_much_is_cut():
    with pytest.raises(
        ValueError, match=r"^the photograph's border cuts off 4\d% of the ball, circle .*at most a third"
    ):
        locate(photographed(SIZE, [Circle(120.0, 8.0, 52.0)]))


def test_an_ellipse_without_a_camera_or_with_another():
    ball = Ball(PinholeCamera.of_fov(SIZE, 45), (0.26, 0.12, -1.0), 7.5)
    image = photographed(SIZE, [ball])
    with pytest.raises(
        ValueError, match=r"is an ellipse, .*no camera is known, .*: --fov (3|4|5)\d would make it one; or"
    ):
        locate(image)
    with pytest.raises(
        ValueError, match=r"no sphere's in a camera of 15 degrees across: --fov (3|4|5)\d would make it "
    ):
        locate(image, PinholeCamera.of_fov(SIZE, 15))
    assert off(locate(image, PinholeCamera.of_fov(SIZE, 45))[0], ball) < 0.15


@pytest.mark.parametrize("given", [Circle(100.0, 60.0, 40.0), Circle(80.0, 72.6, 20.0), Circle(84.0, 72.6, 38.4)])
def test_another_ball_than_is_given(given):
    """Given aside, inside, and a tenth of the radius off."""
    found = another(photographed(SIZE, [LARGE]), given)
    assert found is not None
    assert off(found.silhouette, LARGE) < 0.15


def test_no_other_ball_is_looked_for_where_one_is_as_given(monkeypatch):
    monkeypatch.setattr(choice, "find_balls", None)
    assert another(photographed(SIZE, [SMALL, LARGE]), LARGE) is None


def test_a_round_outline_far_off_the_axis_is_not_by_a_wide_camera():
    image = photographed(SIZE, [Circle(60.0, 50.0, 40.0)])
    with pytest.raises(ValueError, match=r"seen best, circle .* no sphere's in a camera of 90 degrees across: "):
        locate(image, PinholeCamera.of_fov(SIZE, 90))


@pytest.mark.parametrize("image", [torch.ones(3, 64, 64), photographed((64, 64), [Circle(32, 32, 32)])])
def test_a_crop_to_the_ball_is_its_inscribed_circle(image):
    assert locate(image) == (Circle(32, 32, 32), "as large as the photograph")


@pytest.mark.parametrize("around", [0.0, 1.5])
def test_a_crop_with_empty_corners_is_one(around):
    image, seen = torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0)), Circle(32, 32, 32).holds(64, 64)
    told = locate(torch.where(seen, image, around))[1]
    assert told == "as large as the photograph, which is cut to it"


@pytest.mark.parametrize("around", [0.0, torch.nan])
def test_what_is_cut_out_is_the_ball_and_a_ball_in_it_is_a_reflection(around):
    reflected, whole = Circle(90.0, 70.0, 40.0), Circle(90, 90, 90)
    image = photographed((180, 180), [reflected])
    assert off(locate(image)[0], reflected) < 0.15
    assert locate(torch.where(whole.holds(180, 180), image, around))[0] == whole


def test_a_smaller_ball_on_one_value_is_none_that_is_cut_out():
    ball = Circle(90.0, 90.0, 80.0)
    image = torch.where(ball.holds(180, 180), photographed((180, 180), [ball]), 0.0)
    assert off(locate(image)[0], ball) < 0.15


@pytest.mark.parametrize("around", [0.0, 0.3])
@pytest.mark.parametrize("radius", [29.0, 31.5, 33.0])
def test_a_ball_a_little_smaller_than_its_picture_before_one_value(around, radius):
    """Too near to its border for an outline to be found; with or without the pixels that the rim cuts."""
    ball, fine = Circle(34.2, 33.9, radius), Circle(8 * 34.2, 8 * 33.9, 8 * radius)
    image = torch.rand(3, 68, 68, generator=torch.Generator().manual_seed(0)) * 0.2 + 0.5
    found, told = locate(torch.where(ball.holds(68, 68), image, around))
    assert told == "before one value, which is all else in the photograph"
    assert off(found, ball) < 0.3
    if radius < 33:
        whole = torch.where(fine.holds(544, 544), image.repeat_interleave(8, 1).repeat_interleave(8, 2), around)
        assert off(locate(torch.nn.functional.avg_pool2d(whole, 8))[0], ball) < 0.3
    camera = PinholeCamera.of_fov((68, 68), 20)
    assert off(locate(torch.where(ball.holds(68, 68), image, around), camera)[0], ball) < 0.3


def test_a_square_photograph_that_shows_no_ball_is_said_to_be_none_for_certain():
    image = torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0)) + 1
    with pytest.warns(
        UserWarning, match=r"^the ball is taken to fill .* neither is a rim seen .*, give its place, --circle X"
    ):
        locate(image)


def test_what_was_recorded_may_be_such_a_crop():
    image = torch.full((3, 150, 200), torch.nan)
    image[:, 50:114, 90:154] = photographed((64, 64), [Circle(32, 32, 32)])
    found = locate(image, window=Window(90, 50, 64, 64))
    assert found == (Circle(122, 82, 32), "as large as what was recorded")


def test_a_ball_in_a_square_photograph_is_found():
    ball = Circle(90.0, 70.0, 40.0)
    silhouette, _ = locate(photographed((180, 180), [ball]))
    assert off(silhouette, ball) < 0.15
