"""Silhouettes found together with the rotation: spheres in a photograph with a background, guessed wrongly.

A photograph has three pixels for each of the view, and its surroundings are as bright as the ball.
"""

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf.alignment.alignment import Alignment, align
from torchbrdf.alignment.silhouette import MOVED, guessed
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.light.probe import LightProbe
from torchbrdf.photograph.moving import MovingSilhouette
from torchbrdf.photograph.observation import observe
from torchbrdf.photograph.silhouette import Circle
from torchbrdf.rendering.tables import render_tables
from torchbrdf.view.normal_map import NormalMapView
from torchbrdf.view.sphere import SphereView
from turns import degrees_between, turn_about

ROOM = LightProbe.default(64)
VIEW = SphereView(32)
STRAIGHT = torch.eye(3, dtype=torch.float64)
TRUTH = Circle(60.0, 58.0, 48.0)

PIXEL = 2 * TRUTH.radius / 32
"""Pixels of the photograph in one of the view."""


@pytest.fixture(scope="module")
def photographs(strangers: dict[str, MerlTable]) -> dict[str, Tensor]:
    """(3, 118, 122) before a wall with a soft pattern, with 1 % noise; pixels are means of four."""
    generator = torch.Generator().manual_seed(2)
    fine = SphereView(192)
    inside = slice(20, 212), slice(24, 216)
    found, names = {}, ("paint", "brass", "clay")
    balls = render_tables([strangers[name] for name in names], ROOM, fine, samples=64)
    for name, ball in zip(names, balls, strict=True):
        coarse = ball[:, fine.mask[0]].mean() * (0.5 + torch.rand(1, 3, 9, 9, generator=generator))
        image = torch.nn.functional.interpolate(coarse, (236, 244), mode="bilinear")[0]
        image[:, *inside] = torch.where(fine.mask, ball, image[:, *inside])
        image = torch.nn.functional.avg_pool2d(image, 2)
        found[name] = image * (1 + 0.01 * torch.randn(image.shape, generator=generator))
    return found


@pytest.fixture(scope="module")
def aligned(quarter_library: MaterialLibrary) -> Callable[..., Alignment]:
    def run(image: Tensor, probe: LightProbe = ROOM, **options: object) -> Alignment:
        return align(image, probe, VIEW, quarter_library, **options)

    return run


def guess(right: float, down: float, grown: float) -> Circle:
    """Off by pixels of the view."""
    return Circle(TRUTH.x + PIXEL * right, TRUTH.y + PIXEL * down, TRUTH.radius + PIXEL * grown)


def off(found: Alignment) -> float:
    """Pixels of the view."""
    assert isinstance(found.silhouette, Circle)
    return found.silhouette.differs(TRUTH) / PIXEL


@pytest.mark.parametrize("material", ["paint", "clay"])
def test_is_found(aligned: Callable[..., Alignment], photographs: dict[str, Tensor], material: str) -> None:
    """From 3 % of the diameter off, glossy or matte; the light was right, and stays."""
    found = aligned(photographs[material], silhouette=guess(0.7, -0.5, 0.3))
    assert off(found) < 0.15
    assert torch.equal(found.rotation, STRAIGHT)
    assert found.ball is not None
    assert found.ball.moved
    assert found.ball.log_gain > 10
    assert max(found.ball.std) < 0.15 * PIXEL
    expected = observe(photographs[material], found.silhouette, size=32)
    assert found.observation is not None
    assert torch.equal(found.observation.image, expected.image)
    assert torch.equal(found.observation.mask, expected.mask)


def test_is_found_with_the_rotation(aligned: Callable[..., Alignment], photographs: dict[str, Tensor]) -> None:
    rotation = turn_about((1, -2, 1.5), 2.5)
    found = aligned(photographs["brass"], ROOM.rotated(rotation.T), silhouette=guess(-0.5, 0.4, -0.2))
    assert off(found) < 0.15
    assert degrees_between(found.rotation, rotation) < 0.3
    assert "; silhouette moved by (" in str(found)


@pytest.mark.parametrize("material", ["paint", "brass", "clay"])
def test_a_right_one_is_left_alone(
    aligned: Callable[..., Alignment], photographs: dict[str, Tensor], material: str
) -> None:
    found = aligned(photographs[material], silhouette=TRUTH)
    assert found.silhouette is TRUTH
    assert found.ball is not None
    assert found.ball.log_gain < MOVED
    assert torch.equal(found.rotation, STRAIGHT)


def test_an_outline_of_something_else_is_not_followed(
    aligned: Callable[..., Alignment], photographs: dict[str, Tensor], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pixel away, and said to be certain; shading knows better."""
    shift = torch.tensor([0.06, 0.0, 0.0], dtype=torch.float64)
    monkeypatch.setattr(MovingSilhouette, "edge", (shift, torch.full((3,), 0.002, dtype=torch.float64)))
    assert aligned(photographs["brass"], silhouette=TRUTH).silhouette is TRUTH


def test_a_ball_in_a_view_that_is_not_in_perspective(quarter_library: MaterialLibrary) -> None:
    ball = Ball(PinholeCamera.of_fov((118, 122), 30), (0.0, 0.0, -1.0), 7.0)
    with pytest.raises(ValueError, match=r"^a Ball is seen in perspective, .* give SphereView.of_ball\(32, ball\)"):
        tb.align(torch.ones(3, 118, 122), ROOM, VIEW, quarter_library, silhouette=ball)


def test_a_standard_deviation_holds_what_is_off(
    aligned: Callable[..., Alignment], photographs: dict[str, Tensor]
) -> None:
    found = aligned(photographs["clay"], silhouette=guess(0.5, 0.5, -0.3))
    assert found.ball is not None
    assert found.silhouette is not None
    off_by = [abs(a - b) for a, b in zip(found.silhouette.circle, TRUTH.circle, strict=True)]
    assert all(distance < 3 * std for distance, std in zip(off_by, found.ball.std, strict=True))


def test_is_searched_coarsely_and_seen_finely(
    quarter_library: MaterialLibrary, photographs: dict[str, Tensor]
) -> None:
    """The observation and the basis images are those of the view that was given."""
    view = SphereView(72)
    found = align(photographs["paint"], ROOM, view, quarter_library, silhouette=guess(0.7, -0.5, 0.3))
    assert off(found) < 0.15
    assert found.observation is not None
    assert found.observation.mask.shape == (1, 72, 72)
    expected = tb.HarmonicBasis(quarter_library, ROOM, view).basis_at()
    torch.testing.assert_close(found.basis.packed, expected.packed)


def test_a_right_one_beside_a_turned_light(aligned: Callable[..., Alignment], photographs: dict[str, Tensor]) -> None:
    rotation = turn_about((1, -2, 1.5), 2.5)
    found = aligned(photographs["paint"], ROOM.rotated(rotation.T), silhouette=TRUTH)
    assert off(found) < 0.1
    assert degrees_between(found.rotation, rotation) < 0.3


def test_without_surroundings(aligned: Callable[..., Alignment], photographs: dict[str, Tensor]) -> None:
    """The ball's mask leaves no rim to go by: shading tells the place, or it stays."""
    start = guess(0.6, -0.4, 0.0)
    mask = TRUTH.holds(118, 122)[None]
    found = aligned(photographs["brass"], silhouette=start, mask=mask)
    assert off(found) < 0.5 * start.differs(TRUTH) / PIXEL


def test_what_a_photograph_cannot_tell(aligned: Callable[..., Alignment]) -> None:
    """A ball as bright as the fog around it has no silhouette, and any rotation."""
    found = aligned(torch.full((3, 118, 122), 0.5), LightProbe(torch.ones(3, 16, 32)), silhouette=TRUTH)
    assert found.silhouette is TRUTH
    assert torch.equal(found.rotation, STRAIGHT)
    assert "; silhouette left as it is: no other explains the photograph clearly better (" in str(found)


def test_a_square_crop_inscribes_its_guess(photographs: dict[str, Tensor]) -> None:
    assert guessed(photographs["paint"][:, :118, :118], None, VIEW, True) == Circle(59.0, 59.0, 59.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"silhouette": True},
            r"the photograph is 118 x 122, and silhouette=True takes a square crop around the ball; .*",
        ),
        (
            {"silhouette": TRUTH, "mask": torch.ones(118, 122, dtype=torch.bool)},
            r"mask must be bool \(1, 118, 122\), .*",
        ),
        ({"silhouette": Circle(400.0, 60.0, 30.0)}, r".*no whole pixel of the ball is left.*"),
    ],
)
def test_bad_input(
    aligned: Callable[..., Alignment], photographs: dict[str, Tensor], options: dict[str, object], message: str
) -> None:
    with pytest.raises(ValueError, match=f"^{message}$") as caught:
        aligned(photographs["paint"], **options)
    assert "\n" not in str(caught.value)


def test_of_a_shape_that_is_no_ball(quarter_library: MaterialLibrary, photographs: dict[str, Tensor]) -> None:
    shape = NormalMapView(torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, 8, 8))
    with pytest.raises(
        ValueError, match=r"^a silhouette can be found of a ball: the view must be a SphereView, got .*$"
    ):
        align(photographs["paint"], ROOM, shape, quarter_library, silhouette=TRUTH)
