"""Where a mirror ball shows the light of a direction, against rays that are traced."""

import math

import pytest
import torch

from mirror_balls import BALL, CAMERA
from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.light.mirror import Reflection

LENS = PinholeCamera.of_fov((480, 720), 60, (350.0, 250.0), (-0.1, 0.02, 0.001, -0.002))
BALLS = (
    BALL,
    Ball(CAMERA, (0, 0, -1), 0.5),
    Ball(PinholeCamera.of_fov((480, 720), 100), (0.5, 0.4, -1), 30.0),
    Ball(LENS, (-0.3, 0.1, -1), 9.0),
)


def directions(count: int = 4000) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=-1)


@pytest.mark.parametrize("ball", BALLS, ids=lambda ball: f"{ball.radius_deg:g}")
def test_light_is_found_where_a_ray_brings_it_from(ball):
    reflection = Reflection(ball)
    wanted = directions()
    _, normals = reflection.normals(wanted)
    seen = torch.isfinite(normals[:, 0])
    found = reflection.light(reflection.places(normals[seen]))
    assert float((found - wanted[seen]).abs().max()) < 2e-7


@pytest.mark.parametrize("ball", BALLS, ids=lambda ball: f"{ball.radius_deg:g}")
def test_the_cone_behind_the_ball_is_not_seen(ball):
    """It is as wide as the ball looks."""
    wanted = directions()
    g, _ = Reflection(ball).normals(wanted)
    hidden = wanted @ torch.tensor(ball.direction, dtype=torch.float64) > math.cos(math.radians(ball.radius_deg))
    assert torch.equal(torch.isnan(g), hidden)


def test_the_middle_shows_what_is_behind_the_camera():
    towards = torch.tensor(BALL.direction, dtype=torch.float64)
    g, normal = Reflection(BALL).normals(-towards)
    assert float(g) == pytest.approx(0, abs=1e-7)
    assert normal.tolist() == pytest.approx((-towards).tolist(), abs=1e-7)


def test_pixels_have_the_solid_angle_of_their_light():
    """Together, of normals up to 60 degrees from the line towards the camera, that of a cap of the sphere."""
    reflection = Reflection(BALL)
    y, x = (torch.arange(n, dtype=torch.float64) + 0.5 for n in CAMERA.size)
    light = reflection.light(torch.stack(torch.broadcast_tensors(x, y[:, None]), -1))
    angle = math.radians(120)
    chosen = -(light @ torch.tensor(BALL.direction, dtype=torch.float64)) > math.cos(angle)
    total = float(reflection.solid_angles(chosen).sum())
    assert total == pytest.approx(2 * math.pi * (1 - math.cos(angle)), rel=0.005)


def test_incidence_is_the_angle_between_normal_and_light():
    reflection = Reflection(BALL)
    wanted = directions(100)
    g, normals = reflection.normals(wanted)
    seen = torch.isfinite(g)
    cosine = (normals * wanted).sum(-1)
    torch.testing.assert_close(reflection.incidence(g)[seen].cos(), cosine[seen], rtol=0, atol=1e-7)
