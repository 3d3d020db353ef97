"""From photographs of mirror balls to light, against the scene that was photographed."""

import math

import pytest
import torch
from torch import Tensor

from mirror_balls import BALL, CAMERA, photographed, room, scene
from probes import texel_directions
from torchbrdf import LightProbe
from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.light import rotation_of, rotation_vector
from torchbrdf.light.mirror import Metal, MirrorPhotograph, unwrapped

ROWS = 64


def difference(found: Tensor, directions: Tensor | None = None) -> float:
    """From the scene: mean over the sphere, or over (H, 2 H) bool, relative."""
    expected = scene(texel_directions(found.shape[1])).permute(2, 0, 1)
    weights = LightProbe(expected).solid_angles
    weights = weights if directions is None else weights * directions
    return float(((found - expected).abs() * weights).sum() / (expected * weights).sum())


@pytest.fixture(scope="module")
def image() -> Tensor:
    return photographed(BALL)


def test_the_light_is_that_of_the_scene_in_the_camera_s_frame(image):
    found = unwrapped([MirrorPhotograph(image, BALL)], height=ROWS)
    assert difference(found.radiance, found.reflected) < 0.003
    assert difference(found.radiance) < 0.01


def test_a_ball_that_lies_elsewhere_than_said_is_seen(image):
    """The ruler: half a pixel of place is."""
    x, y, radius = BALL.circle
    off = unwrapped([MirrorPhotograph(image, Ball.of_circle(CAMERA, x + 0.5, y, radius))], height=ROWS)
    assert difference(off.radiance, off.reflected) > 0.006


def test_a_lens_is_undone():
    camera = PinholeCamera.of_fov((120, 180), 50, (85.0, 64.0), (-0.15, 0.03, 0.002, -0.001))
    ball = Ball(camera, (0.1, 0.1, -1.0), 12.0)
    found = unwrapped([MirrorPhotograph(photographed(ball), ball)], height=ROWS)
    assert difference(found.radiance, found.reflected) < 0.003


def test_what_the_ball_hides_is_seen_beside_it_and_filled_behind_it(image):
    found = unwrapped([MirrorPhotograph(image, BALL)], height=ROWS)
    alone = unwrapped([MirrorPhotograph(image, BALL)], height=ROWS, beside=False)
    assert torch.equal(alone.filled, found.filled | found.beside)
    assert not bool(alone.beside.any())
    assert found.share(found.beside) > 0.005
    assert difference(found.radiance, found.beside) < 0.003
    cone = (1 - math.cos(math.radians(BALL.radius_deg))) / 2
    assert found.share(found.filled) > cone


@pytest.mark.parametrize("given", [0.6, (0.5, 0.6, 0.7)])
def test_the_reflectance_is_divided_out_of_the_ball_alone(given):
    factor = torch.tensor(given).expand(3).double()
    image = photographed(BALL, reflectance=lambda angles: factor.expand(*angles.shape, 3))
    found = unwrapped([MirrorPhotograph(image, BALL)], given, ROWS)
    assert difference(found.radiance, found.reflected) < 0.003
    assert difference(found.radiance, found.beside) < 0.003


def test_a_metal_reflects_by_angle():
    metal = Metal.open("Cr")
    image = photographed(BALL, reflectance=metal.reflectance)
    found = unwrapped([MirrorPhotograph(image, BALL)], metal, ROWS)
    straight = unwrapped([MirrorPhotograph(image, BALL)], metal.reflectance(torch.zeros(())).tolist(), ROWS)
    assert difference(found.radiance, found.reflected) < 0.003
    assert difference(straight.radiance, straight.reflected) > 0.006


def test_rows_follow_the_photograph(image, monkeypatch):
    """Of a light probe there are 512 at least, see tests/light/test_picture.py; here 96."""
    monkeypatch.setattr("torchbrdf.light.mirror.photographs.LEAST_HEIGHT", 96)
    assert unwrapped([MirrorPhotograph(image, BALL)]).radiance.shape == (3, 96, 192)
    large = Ball(PinholeCamera.of_fov((140, 140), 20), (0, 0, -1), 9.8)
    found = unwrapped([MirrorPhotograph(torch.ones(3, 140, 140), large)])
    assert found.radiance.shape[1] == math.ceil(math.pi / 2 * large.circle[2]) > 96
    torch.testing.assert_close(found.radiance, torch.ones_like(found.radiance))


def test_pixels_without_radiance_are_filled(image):
    x, y, _ = (int(each) for each in BALL.circle)
    image = image.clone()
    image[:, y - 3 : y + 2, x + 5 : x + 10] = math.nan
    photograph = MirrorPhotograph(image, BALL)
    found = unwrapped([photograph], height=ROWS)
    assert photograph.empty == 25
    assert difference(found.radiance) < 0.01
    whole = unwrapped([MirrorPhotograph(photographed(BALL), BALL)], height=ROWS)
    assert found.share(found.filled) > whole.share(whole.filled) + 0.002


SUN = torch.nn.functional.normalize(torch.tensor([0.6, 0.5, 0.6], dtype=torch.float64), dim=0)


def sunny(directions: Tensor) -> Tensor:
    """The scene, infinite in a disc of 4 degrees' radius."""
    sun = directions.double() @ SUN > math.cos(math.radians(4))
    return torch.where(sun[..., None], math.inf, scene(directions))


@pytest.mark.parametrize("rows", [24, 256])
def test_a_lamp_too_bright_is_passed_on_where_it_is(rows):
    found = unwrapped([MirrorPhotograph(photographed(BALL, sunny), BALL)], height=rows)
    infinite = torch.isposinf(found.radiance)
    weights = LightProbe(torch.ones_like(found.radiance)).solid_angles
    middle = (texel_directions(rows) * (weights * infinite[0])[..., None]).sum((0, 1))
    assert torch.equal(infinite, infinite[:1].expand(3, -1, -1))
    assert float(torch.nn.functional.normalize(middle, dim=0) @ SUN) > math.cos(math.radians(1 + 45 / rows))
    assert difference(torch.where(infinite, scene(texel_directions(rows)).permute(2, 0, 1), found.radiance)) < 0.03


def test_a_lamp_seen_from_two_sides_is_one():
    one = MirrorPhotograph(photographed(BALL, lambda d: torch.where(sunny(d) < math.inf, room(d), math.inf)), BALL)
    seen = photographed(OTHER, lambda d: torch.where(sunny(d @ TURN.T) < math.inf, room(d @ TURN.T), math.inf))
    found = unwrapped([one, MirrorPhotograph(seen, OTHER)], height=64)
    toward = texel_directions(64)[torch.isposinf(found.radiance[0])].double()
    assert float((toward @ SUN).min()) > math.cos(math.radians(8))


def test_a_lamp_beside_the_ball_is_passed_on(image):
    image = image.clone()
    image[:, 2:4, 3:6] = math.inf
    found = unwrapped([MirrorPhotograph(image, BALL)], height=256)
    infinite = torch.isposinf(found.radiance[0])
    place = CAMERA.project(texel_directions(256)[infinite].double())
    assert len(place)
    assert (place - torch.tensor([4.5, 3.0])).abs().max() < 2.5


def test_clipped_pixels_are_too_bright():
    whole = photographed(BALL, lambda d: room(d) + 500 * torch.exp(800 * (d.double() @ SUN - 1))[..., None])
    clipped = MirrorPhotograph(whole.clamp_max(20.0), BALL).with_lamps_lost()
    assert torch.equal(clipped.infinite & clipped.shown, (whole >= 20 * 0.999) & clipped.shown)
    assert clipped.lost > 3


def test_what_is_not_clipped_stays(image):
    photograph = MirrorPhotograph(photographed(BALL, room), BALL)
    assert photograph.with_lamps_lost() is photograph
    assert photograph.white < 0.001


def test_much_white_is_no_lamp():
    photograph = MirrorPhotograph(photographed(BALL, room).clamp_max(1.5), BALL)
    assert photograph.with_lamps_lost() is photograph
    assert photograph.white > 0.01


def test_what_is_no_mirror_photograph(image):
    with pytest.raises(ValueError, match=r"^a photograph by this camera is \(3, 120 x 180\), got \(3, 60, 60\)$"):
        MirrorPhotograph(torch.ones(3, 60, 60), BALL)
    for bad, mask in ((torch.full((3, 120, 180), math.inf), None), (image, torch.zeros(120, 180, dtype=torch.bool))):
        with pytest.raises(ValueError, match=r"^no pixel of the ball can be used: the mask leaves none, or all are"):
            MirrorPhotograph(bad, BALL, mask)
    with pytest.raises(ValueError, match=r"^a mirror probe is made of one or two photographs, got 3$"):
        unwrapped([MirrorPhotograph(image, BALL)] * 3)


# --- Two photographs -------------------------------------------------------------------------------------

TURN = rotation_of(torch.tensor([0.15, 1.7, -0.1]))
"""A direction d in the second camera's frame is R d in the first's."""

OTHER = Ball(CAMERA, (-0.05, 0.04, -1.0), 9.0)


@pytest.fixture(scope="module")
def two() -> tuple[MirrorPhotograph, MirrorPhotograph]:
    return (
        MirrorPhotograph(photographed(BALL, room), BALL),
        MirrorPhotograph(photographed(OTHER, lambda d: room(d @ TURN.T)), OTHER),
    )


def test_a_second_photograph_fills_what_the_first_did_not_see(two):
    found = unwrapped(two, height=64, beside=False)
    alone = unwrapped(two[:1], height=64, beside=False)
    assert found.turn is not None
    off = rotation_vector(found.turn.rotation @ TURN.T).norm()
    assert math.degrees(float(off)) < 0.15
    assert found.turn.gain == 1
    assert found.share(found.filled) == 0 < alone.share(alone.filled)
    expected = room(texel_directions(64)).permute(2, 0, 1)
    weights = LightProbe(expected).solid_angles
    errors = [float(((each.radiance - expected) ** 2 * weights).sum()) for each in (found, alone)]
    assert errors[0] < errors[1] / 2


@pytest.mark.parametrize("vector", [(0.0, math.pi, 0.0), (0.0, 0.0, 0.0), (2.0, 0.5, -1.0)])
def test_cameras_may_stand_anywhere(two, vector):
    """Opposite each other, too, where each sees sharply what the other sees at its rim."""
    turn = rotation_of(torch.tensor(vector))
    other = MirrorPhotograph(photographed(OTHER, lambda d: room(d @ turn.T)), OTHER)
    found = unwrapped([two[0], other], height=64, beside=False)
    assert found.turn is not None
    assert math.degrees(float(rotation_vector(found.turn.rotation @ turn.T).norm())) < 0.2
    assert found.turn.gain == 1


def test_another_exposure_is_found_and_scaled(two):
    brighter = MirrorPhotograph(2 * two[1].image, OTHER)
    found = unwrapped([two[0], brighter], height=64, beside=False)
    assert found.turn is not None
    assert found.turn.gain == pytest.approx(2, rel=0.03)


def test_photographs_of_other_light_are_refused(two):
    with pytest.raises(ValueError, match=r"^the two photographs do not show one light: turned at best, their correlat"):
        unwrapped([two[0], MirrorPhotograph(photographed(OTHER), OTHER)], height=64)
