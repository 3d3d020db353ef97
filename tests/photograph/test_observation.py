"""Averages of a photograph over the pixels of a view: exact boxes, typed messages."""

from math import radians, sin

import numpy as np
import pytest
import torch
from torch import Tensor

from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.photograph._summed_area import SummedArea
from torchbrdf.photograph.observation import observe, observe_view, tilted_boxes
from torchbrdf.photograph.silhouette import Circle, find_circle
from torchbrdf.view.normal_map import NormalMapView
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


BAD_MASKS = {
    "twice as large": (torch.ones(1, 48, 64) > 0, r"mask must have the size of the photograph, 24 x 32, got 48 x 64"),
    "smaller": (torch.ones(1, 3, 4) > 0, r"mask must have the size of the photograph, 24 x 32, got 3 x 4"),
    "two axes": (torch.ones(24, 32) > 0, r"mask must be bool \(1, 24, 32\), got torch\.bool \(24, 32\)"),
    "floats": (torch.ones(1, 24, 32), r"mask must be bool \(1, 24, 32\), got torch\.float32 \(1, 24, 32\)"),
    "an array": (np.ones((1, 24, 32), bool), r"mask must be a tensor of bool, got ndarray; see torch\.from_numpy"),
}

BAD_IMAGES = {
    "an array": (np.ones((3, 24, 32)), r"image must be a tensor \(3, H, W\), got ndarray; see torch\.from_numpy"),
    "one channel": (torch.ones(1, 24, 32), r"image must be \(3, H, W\), got \(1, 24, 32\)"),
    "channels last": (
        torch.ones(24, 32, 3),
        r"image must be \(3, H, W\), got \(24, 32, 3\); permute it: image\.movedim\(-1, -3\)",
    ),
    "integers": (
        torch.ones(3, 24, 32, dtype=torch.uint8),
        r"image must hold linear floating-point radiance, got torch\.uint8; decode the file, "
        r"torchbrdf\.read_image\(path, allow_ldr=True\)",
    ),
}


@pytest.mark.parametrize("mask", BAD_MASKS)
def test_a_mask_that_is_none_of_the_photograph(mask: str):
    """One of another size would be read in its top left corner."""
    given, message = BAD_MASKS[mask]
    image = torch.ones(3, 24, 32)
    for call in (
        lambda: observe(image, Circle(16, 12, 10), given, size=8),
        lambda: observe_view(image, oblong_view(), given),
        lambda: find_circle((24, 32), given),
    ):
        with pytest.raises(ValueError, match=f"^{message}$"):
            call()


@pytest.mark.parametrize("image", BAD_IMAGES)
def test_an_image_that_is_no_photograph(image: str):
    """Means of whole numbers would be cut to whole numbers."""
    given, message = BAD_IMAGES[image]
    for call in (lambda: observe(given, Circle(16, 12, 10)), lambda: observe_view(given, oblong_view())):
        with pytest.raises(ValueError, match=f"^{message}$"):
            call()


def oblong_view() -> NormalMapView:
    normals = torch.zeros(3, 12, 16)
    normals[2] = 1
    return NormalMapView(normals)


def shaded(normals: Tensor, view_dirs: Tensor) -> Tensor:
    """(3, ...): some radiance that depends on both."""
    cos_o = (normals * view_dirs).sum(0)
    return torch.stack([1 + normals[0], 1 + normals[1] * cos_o, (2 + normals[2]) * cos_o])


def photographed(ball: Ball, samples: int = 4) -> Tensor:
    """(3, H, W): what the camera records of a ball whose radiance is `shaded`, and a bright background."""
    height, width = ball.camera.size
    steps = [((torch.arange(n * samples) + 0.5) / samples).double() for n in (height, width)]
    y, x = torch.meshgrid(*steps, indexing="ij")
    rays = ball.camera.rays(torch.stack([x, y], -1)).movedim(-1, 0)
    middle = torch.tensor(ball.direction, dtype=torch.float64)[:, None, None] / sin(radians(ball.radius_deg))
    along = (rays * middle).sum(0)
    root = along.square() - middle.square().sum() + 1
    hit = (along - root.clamp_min(0).sqrt()) * rays - middle
    image = torch.where(root > 0, shaded(hit / hit.norm(dim=0), -rays), 7.0)
    return image.unflatten(2, (width, samples)).unflatten(1, (height, samples)).mean((2, 4))


@pytest.mark.parametrize(
    ("fov_deg", "direction", "lens"),
    [
        (24.0, (0.1, 0.08, -1.0), ()),
        (70.0, (0.3, -0.25, -1.0), ()),
        (60.0, (-0.3, 0.2, -1.0), (-0.15, 0.03, 1e-3, -1e-3)),
    ],
)
def test_a_ball_off_the_axis_is_seen_as_its_view_says(
    fov_deg: float, direction: tuple[float, float, float], lens: tuple[float, ...]
):
    ball = Ball(PinholeCamera.of_fov((160, 240), fov_deg, distortion=lens), direction, fov_deg / 8)
    seen = observe(photographed(ball), ball, size=20)
    view = SphereView(20, fov_deg=ball.fov_deg, direction=ball.direction)
    steps = (torch.arange(16) + 0.5) / 16
    u, v = (places.expand(len(view.pixels), -1) for places in torch.cartesian_prod(steps, steps).T)
    points = view.surface(view.pixels, u, v)
    expected = view.unpack(shaded(points.normals, points.view_dirs).mean(-1))
    error = (seen.image - expected)[:, seen.mask[0]]
    assert seen.mask.sum() >= view.mask.sum() - 20
    assert float(error.abs().max()) < 0.012
    assert abs(float(error.mean())) < 5e-4


def test_an_observation_is_differentiable_in_the_ball():
    photograph = torch.rand(1, 90, 120, generator=torch.Generator().manual_seed(0))
    moved = torch.zeros(2, dtype=torch.float64, requires_grad=True)

    def mean(offset: Tensor) -> Tensor:
        boxes = tilted_boxes(lambda x, y: torch.stack([60.3 + 39.6 * x, 45.2 - 40.1 * y], -1) + offset, 8)
        return (SummedArea(photograph).over(boxes) / boxes.area).mean()

    assert torch.autograd.gradcheck(mean, (moved,), eps=1e-4, atol=1e-6)
