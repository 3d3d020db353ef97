"""A mirror ball is told from a matte one."""

import pytest
import torch

from mirror_balls import BALL, CAMERA, photographed, room, scene
from torchbrdf.light.mirror.matte import looks_matte
from torchbrdf.light.mirror.pixels import inside
from torchbrdf.light.mirror.reflection import Reflection


@pytest.mark.parametrize("light", [scene, room])
def test_a_mirror_is_one_in_smooth_light_and_among_lamps(light):
    assert not looks_matte(photographed(BALL, light), inside(BALL), BALL)


@pytest.mark.parametrize("light", [scene, room])
def test_a_shaded_ball_is_none(light):
    y, x = torch.meshgrid(*(torch.arange(n) + 0.5 for n in CAMERA.size), indexing="ij")
    normals = Reflection(BALL).normals_at(torch.stack([x, y], -1).double())
    shading = 0.1 + (normals @ torch.tensor([0.6, 0.64, 0.48], dtype=torch.float64)).clamp_min(0)
    image = torch.where(inside(BALL), shading, photographed(BALL, light))
    assert looks_matte(image.float(), inside(BALL), BALL)


def test_a_shaded_ball_that_fills_its_picture_is_none():
    image = torch.linspace(0.2, 1, CAMERA.size[1]).expand(3, *CAMERA.size).clone()
    image[:, ~inside(BALL)] = torch.nan
    assert looks_matte(image, inside(BALL), BALL)
