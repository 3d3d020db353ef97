"""Mirror balls, whose rims show what lies beside them."""

import math

import pytest
import torch
from torch import Tensor

from photographs_of_balls import off
from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.photograph import find_balls

SIZE, FACTOR = (200, 300), 4
CAMERA = PinholeCamera.of_fov(SIZE, 24)
BALL = Ball(CAMERA, (0.03, -0.02, -1.0), 4.0)


WAVES = torch.tensor([[7.0, 2.0, 3.0], [-3.0, 6.0, 4.0], [2.0, -5.0, 8.0]])
PHASES = torch.tensor([0.3, 1.7, 2.9])


def surroundings(directions: Tensor) -> Tensor:
    """(..., 3): radiance in coarse and fine waves around the sphere."""
    coarse, fine = directions @ WAVES.T, 8 * directions @ WAVES.T.flip(0)
    return 1 + 0.3 * torch.sin(coarse + PHASES) + 0.2 * torch.sin(fine + PHASES)


def mirror(reflectance: float) -> Tensor:
    """(3, H, W): the ball reflects what would be seen without it; 1 % noise."""
    y, x = ((torch.arange(FACTOR * side) + 0.5) / FACTOR for side in SIZE)
    rays = CAMERA.rays(torch.stack(torch.meshgrid(x, y, indexing="xy"), -1).double()).float()
    middle = torch.tensor(BALL.direction) / math.sin(math.radians(BALL.radius_deg))
    along = rays @ middle
    depth = along**2 - middle.square().sum() + 1
    normals = (along - depth.clamp_min(0).sqrt())[..., None] * rays - middle
    reflected = rays - 2 * (rays * normals).sum(-1, keepdim=True) * normals
    radiance = torch.where((depth > 0)[..., None], reflectance * surroundings(reflected), surroundings(rays))
    image = torch.nn.functional.avg_pool2d(radiance.permute(2, 0, 1)[None], FACTOR)[0]
    return image * (1 + 0.01 * torch.randn(image.shape, generator=torch.Generator().manual_seed(0)))


@pytest.fixture(scope="module")
def found():
    return find_balls(mirror(1.0), CAMERA)[0]


def test_a_mirror_is_found_where_directions_begin_to_crowd(found):
    assert off(found.silhouette, BALL) < 0.15


def test_that_edges_alone_would_place_it_elsewhere_is_told(found):
    assert found.doubt > 0.2 * found.circle.radius / 32
