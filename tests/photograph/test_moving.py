"""What a photograph shows wherever a silhouette is: exact places and derivatives, the same pixels, the same noise."""

from math import radians, tan

import pytest
import torch
from torch import Tensor

from photographs_of_balls import off, photographed
from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.photograph.moving import REACH, MovingSilhouette
from torchbrdf.photograph.observation import observe
from torchbrdf.photograph.silhouette import Circle
from torchbrdf.view.sphere import SphereView

SIZE = (90, 110)
CIRCLE = Circle(52.3, 44.1, 30.7)
BALL = Ball.of_circle(PinholeCamera.of_fov(SIZE, 30), 70.0, 50.0, 24.0)
NONE = torch.zeros(3, dtype=torch.float64)
SHIFT = torch.tensor([0.021, -0.034, 0.027], dtype=torch.float64)


def textured(size: tuple[int, int] = SIZE) -> Tensor:
    return torch.rand(3, *size, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def ramps(size: tuple[int, int] = SIZE) -> Tensor:
    """A plane in each channel, as pixels show it: smearing changes a mean by little."""
    y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) + 0.5 for n in size), indexing="ij")
    return torch.stack([x, y, 1 + x + 2 * y])


def test_sees_what_is_observed() -> None:
    observed = observe(ramps(), CIRCLE, size=16)
    moving = MovingSilhouette(ramps(), CIRCLE, None, 16)
    both = observed.mask[0][SphereView(16).mask[0]]
    torch.testing.assert_close(moving.seen(NONE)[:, both], observed.image[:, observed.mask[0]], rtol=0, atol=0.1)


@pytest.mark.parametrize("guess", [CIRCLE, BALL], ids=["circle", "ball"])
def test_what_it_sees_after_a_shift_is_what_the_shifted_silhouette_sees(guess: Circle | Ball) -> None:
    """Of a ball to second order: it is a cone wherever it lies."""
    moving = MovingSilhouette(ramps(), guess, None, 16)
    there = MovingSilhouette(ramps(), moving.at(SHIFT), None, 16)
    assert bool(moving.used.all())
    assert bool(there.used.all())
    torch.testing.assert_close(moving.seen(SHIFT), there.seen(NONE), rtol=0, atol=1e-9 if guess is CIRCLE else 0.05)
    assert float((moving.seen(SHIFT) - moving.seen(NONE)).abs().max()) > 1


def test_a_shift_goes_right_and_up_in_radii() -> None:
    found = MovingSilhouette(textured(), CIRCLE, None, 16).at(torch.tensor([0.05, 0.02, 0.01]))
    assert isinstance(found, Circle)
    assert (found.x, found.y) == pytest.approx((52.3 + 0.05 * 30.7, 44.1 - 0.02 * 30.7))
    assert found.radius == pytest.approx(30.7 * 1.01005, rel=1e-5)
    ball = MovingSilhouette(textured(), BALL, None, 16).at(torch.tensor([0.0, 0.0, 0.01]))
    assert isinstance(ball, Ball)
    assert ball.direction == pytest.approx(BALL.direction)
    assert tan(radians(ball.radius_deg)) == pytest.approx(1.01005 * tan(radians(BALL.radius_deg)), rel=1e-5)


@pytest.mark.parametrize("guess", [CIRCLE, BALL], ids=["circle", "ball"])
def test_change(guess: Circle | Ball) -> None:
    """Against differences, between the kinks where sides cross the edges of pixels."""
    moving, step = MovingSilhouette(textured(), guess, None, 12), 1e-6
    change = moving.change(SHIFT)
    for k, axis in enumerate(torch.eye(3, dtype=torch.float64)):
        difference = (moving.seen(SHIFT + step * axis) - moving.seen(SHIFT - step * axis)) / (2 * step)
        close = (change[k] - difference).abs() < 1e-5 * change[k].abs().max()
        assert float(close.double().mean()) > 0.99


@pytest.mark.parametrize("guess", [CIRCLE, BALL], ids=["circle", "ball"])
def test_the_shift_to_where_a_shift_leads(guess: Circle | Ball) -> None:
    moving = MovingSilhouette(textured(), guess, None, 12)
    torch.testing.assert_close(moving.shift_to(moving.at(SHIFT)), SHIFT, rtol=0, atol=1e-9)


@pytest.mark.parametrize("ball", [CIRCLE, BALL], ids=["circle", "ball"])
def test_the_edge_is_where_the_outline_is(ball: Circle | Ball) -> None:
    """From most of the reach away; a fifteenth of a radius is two pixels."""
    camera = ball.camera if isinstance(ball, Ball) else None
    image = photographed(SIZE, [ball])
    wide = MovingSilhouette(image, ball, None, 12)
    found = MovingSilhouette(image, wide.at(torch.tensor([0.05, -0.02, -0.06])), None, 12)
    assert found.edge is not None
    edge, std = found.edge
    back = found.at(edge)
    assert off(back, ball) < 0.15
    assert camera is None or isinstance(back, Ball)
    assert bool((std > 0).all())
    assert bool((std < 0.01).all())


def test_no_edge_where_none_is_seen() -> None:
    """Of a mask that follows the ball, and of a crop in black."""
    image = photographed(SIZE, [CIRCLE])
    disc = CIRCLE.holds(*SIZE)[None]
    assert MovingSilhouette(image, CIRCLE, disc, 12).edge is None
    assert MovingSilhouette(torch.where(disc, image, 0), CIRCLE, None, 12).edge is None


def test_no_edge_out_of_reach() -> None:
    image = photographed(SIZE, [CIRCLE])
    away = MovingSilhouette(image, Circle(CIRCLE.x + 3.0, CIRCLE.y, CIRCLE.radius), None, 12)
    assert away.edge is None


def test_uses_what_is_usable_wherever_the_silhouette_lies() -> None:
    """In the photograph, finite, not cut out, and under the mask: with a margin of its reach, and no more."""
    image, mask = textured(), torch.ones(1, *SIZE, dtype=torch.bool)
    assert bool(MovingSilhouette(image, CIRCLE, mask, 16).used.all())
    beside = Circle(CIRCLE.radius, 44.1, CIRCLE.radius)
    used = SphereView(16).unpack(MovingSilhouette(image, beside, None, 16).used[None].double())[0]
    assert float(used[:, 0].sum()) == 0
    assert bool(used[SphereView(16).mask[0]].reshape(-1)[-1] == 1)
    mask[0, 44, 52] = False
    lost = ~MovingSilhouette(image, CIRCLE, mask, 16).used
    assert 1 < int(lost.sum()) < 4 * (2 + REACH * 16) ** 2
    for value in (float("nan"), 0.0):
        image[:, 44, 52] = value
        assert torch.equal(~MovingSilhouette(image, CIRCLE, None, 16).used, lost)


def test_noise_is_the_same_wherever_the_sides_lie() -> None:
    """Three pixels of the photograph each way in one: means over whole pixels and over halves are as noisy."""
    image = torch.randn(3, 216, 216, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    moving = MovingSilhouette(image, Circle(108, 108, 96), None, 64)
    spread = [float(moving.seen(torch.tensor([x, x, 0.0]).double() / 96).std()) for x in (0, 0.25, 0.5)]
    assert max(spread) < 1.04 * min(spread)


def test_nothing_left_to_search() -> None:
    message = r"^the circle at .* cannot be searched: none of its pixels is usable wherever it may lie within 8% of .*$"
    with pytest.raises(ValueError, match=message):
        MovingSilhouette(textured(), CIRCLE, torch.zeros(1, *SIZE, dtype=torch.bool), 16)
