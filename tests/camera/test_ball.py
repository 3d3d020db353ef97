"""Where a camera sees a ball."""

from math import cos, hypot, radians, sin, sqrt

import pytest
import torch

from torchbrdf.camera import Ball, PinholeCamera, turned_to

CAMERA = PinholeCamera.of_fov((480, 720), 24)
WIDE = PinholeCamera.of_fov((480, 720), 70, (350.0, 250.0), (-0.2, 0.05, 1e-3, -2e-3))


def test_the_outline_touches_the_ball():
    ball = Ball(CAMERA, (0.1, -0.05, -1), 3.0)
    cosines = CAMERA.rays(ball.outline(64)) @ torch.tensor(ball.direction, dtype=torch.float64)
    assert torch.allclose(cosines, torch.full_like(cosines, cos(radians(3.0))))


def test_the_silhouette_is_the_ellipse_of_its_cone():
    ball = Ball(CAMERA, (sin(radians(9)), 0, -cos(radians(9))), 4.0)
    theta, alpha = radians(9), radians(4)
    lessened = cos(alpha) ** 2 - sin(theta) ** 2
    x, y, radius = ball.circle
    assert x == pytest.approx(360 + CAMERA.focal * sin(theta) * cos(theta) / lessened)
    assert y == pytest.approx(240)
    long, short = sin(alpha) * cos(alpha) / lessened, sin(alpha) / sqrt(lessened)
    assert radius == pytest.approx(CAMERA.focal * sqrt(long * short), rel=1e-5)


@pytest.mark.parametrize("camera", [CAMERA, WIDE])
@pytest.mark.parametrize("circle", [(360, 240, 100), (520, 140, 60), (80, 400, 70), (660, 430, 40)])
def test_a_circle_becomes_the_ball_that_shows_it(camera: PinholeCamera, circle: tuple[float, float, float]):
    assert Ball.of_circle(camera, *circle).circle == pytest.approx(circle, abs=1e-4)


def test_the_turned_camera_looks_at_the_middle():
    ball = Ball(WIDE, (0.3, 0.2, -1), 5.0)
    middle = ball.places(torch.zeros(1, dtype=torch.float64), torch.zeros(1, dtype=torch.float64))
    assert torch.allclose(WIDE.project(torch.tensor([ball.direction], dtype=torch.float64)), middle)
    right, up = (ball.places(torch.tensor([x]), torch.tensor([y])) - middle for x, y in ((0.5, 0.0), (0.0, 0.5)))
    assert right[0, 0] > 0 > up[0, 1]


@pytest.mark.parametrize("direction", [(0, 0, -1), (0.1, 0.2, -1), (-1, 0.5, -0.1), (0.3, -0.2, 1)])
def test_the_least_rotation_takes_ahead_to_the_direction(direction: tuple[float, float, float]):
    length = hypot(*direction)
    unit = torch.tensor(direction, dtype=torch.float64) / length
    turn = turned_to(unit.tolist())
    assert torch.allclose(turn @ torch.tensor([0.0, 0, -1], dtype=torch.float64), unit)
    assert torch.allclose(turn @ turn.T, torch.eye(3, dtype=torch.float64), atol=1e-12)
    assert float(turn.trace()) == pytest.approx(1 - 2 * float(unit[2]))
    assert float(torch.linalg.det(turn)) == pytest.approx(1)


@pytest.mark.parametrize(
    ("direction", "radius"), [((0, 0, -1), 0), ((0, 0, -1), 90), ((1, 0, -0.1), 10), ((0, 0, 0), 5), ((0, 0, 1), 5)]
)
def test_what_is_no_ball_before_the_camera_is_refused(direction: tuple[float, float, float], radius: float):
    with pytest.raises(ValueError, match="must"):
        Ball(CAMERA, direction, radius)


def test_a_circle_that_no_ball_fills_is_refused():
    with pytest.raises(ValueError, match="ball"):
        Ball.of_circle(PinholeCamera.of_fov((48, 72), 150), 70, 3, 200)
