"""Balls in whole photographs: known outlines, what hides a part of them, and what is no ball."""

import pytest
import torch

from finding_scenes import compose
from photographs_of_balls import off, photographed
from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.light import LightProbe
from torchbrdf.photograph import Circle, find_balls
from torchbrdf.photograph.finding import find_near

SIZE = (160, 240)
BALL = Circle(101.3, 72.6, 38.4)
NEAR = 0.15


@pytest.fixture(scope="module")
def before_a_wall():
    return find_balls(photographed(SIZE, [BALL]))


def test_a_ball_before_a_wall(before_a_wall):
    (found,) = [one for one in before_a_wall if one.sure]
    assert off(found.silhouette, BALL) < NEAR
    assert found.round
    assert found.outside == 0


def test_a_standard_deviation_holds_the_deviation(before_a_wall):
    found = before_a_wall[0]
    deviations = (found.circle.x - BALL.x, found.circle.y - BALL.y, found.circle.radius - BALL.radius)
    assert all(abs(one) < 3 * std for one, std in zip(deviations, found.std, strict=True))
    assert max(found.std) < 0.5


def test_the_largest_comes_first():
    small = Circle(200.0, 110.0, 21.5)
    first, second = (one for one in find_balls(photographed(SIZE, [small, BALL])) if one.sure)
    assert off(first.silhouette, BALL) < NEAR
    assert off(second.silhouette, small) < 2 * NEAR


def test_a_rod_that_hides_a_part_of_the_rim_does_not_move_it():
    image = photographed(SIZE, [BALL])
    image[:, 95:, 90:112] = 0.2
    found = find_balls(image)[0]
    assert off(found.silhouette, BALL) < NEAR
    assert found.sure


def test_a_part_in_the_dark_does_not_move_it():
    image = photographed(SIZE, [BALL])
    image[:, :, 120:] = 0.01
    found = find_balls(image)[0]
    assert off(found.silhouette, BALL) < NEAR
    assert 0.5 < found.rim < 0.9


def test_what_is_not_usable_is_not_looked_at():
    image, usable = photographed(SIZE, [BALL]), torch.ones(1, *SIZE, dtype=torch.bool)
    image[:, :60, :] = torch.nan
    usable[:, :, 125:] = False
    image[:, :, 125:] = 100
    found = find_balls(image, usable=usable)[0]
    assert off(found.silhouette, BALL) < 2 * NEAR


def test_a_border_that_cuts_a_quarter_is_said():
    cut = Circle(101.3, 30.0, 46.0)
    found = find_balls(photographed(SIZE, [cut]))[0]
    assert off(found.silhouette, cut) < NEAR
    assert found.outside == pytest.approx(0.12, abs=0.02)
    assert found.sure


def test_an_ellipse_off_the_axis_is_a_ball_before_its_camera():
    camera = PinholeCamera.of_fov(SIZE, 70)
    ball = Ball(camera, (0.5, 0.25, -1.0), 10.0)
    found = find_balls(photographed(SIZE, [ball]), camera)[0]
    assert isinstance(found.silhouette, Ball)
    cosine = sum(a * b for a, b in zip(found.silhouette.direction, ball.direction, strict=True))
    assert cosine > 0.999999
    assert found.silhouette.radius_deg == pytest.approx(10.0, abs=0.06)
    assert found.round


@pytest.mark.parametrize("image", [torch.zeros(3, 90, 120), torch.ones(3, 90, 120), photographed(SIZE, [])])
def test_no_ball_is_none(image):
    assert not [one for one in find_balls(image) if one.sure]


def test_a_ball_before_nothing():
    image = torch.where(BALL.holds(*SIZE), photographed(SIZE, [BALL]), 0)
    (found,) = find_balls(image)
    assert found.sure
    assert off(found.silhouette, BALL) < 0.15


def test_a_photograph_too_small_for_a_ball_has_none():
    assert find_balls(torch.rand(3, 8, 9)) == []


@pytest.mark.parametrize("seed", [0, 3, 10])
def test_scenes_with_stands_mirrors_and_blur(seed):
    scene = compose(LightProbe.default().radiance, seed, (240, 360))
    camera = PinholeCamera.of_fov((240, 360), scene.fov_deg)
    direction, radius_deg, _ = max(scene.balls, key=lambda one: one[1])
    x, y, z = direction.tolist()
    sure = [one for one in find_balls(scene.image, camera) if one.sure]
    assert off(sure[0].silhouette, Ball(camera, (x, y, z), radius_deg)) < 2 * NEAR


@pytest.mark.parametrize(
    ("image", "usable", "message"),
    [
        (torch.ones(9, 8, 3), None, r"^image must be \(3, H, W\), got \(9, 8, 3\); permute it: image\.movedim"),
        (torch.ones(3, 9, 8, dtype=torch.uint8), None, r"^image must hold linear floating-point radiance, got torch"),
        (torch.ones(3, 9, 8), torch.ones(1, 8, 9, dtype=torch.bool), "^mask must have the size of the photograph"),
    ],
)
def test_what_is_no_photograph(image, usable, message):
    with pytest.raises(ValueError, match=message):
        find_balls(image, usable=usable)
    with pytest.raises(ValueError, match=message):
        find_near(image, Circle(4.0, 4.0, 3.0), usable)
