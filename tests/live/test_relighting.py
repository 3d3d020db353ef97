"""Relit spheres: against the sampled transport, in every orientation of the light."""

import math

import pytest
import torch

from materials import glossy, lambert
from torchbrdf import BRDFEstimator, LightProbe, MaterialClasses, MaterialLibrary, MerlTable, SphereView, render_basis
from torchbrdf.live.relighting import Relighter
from torchbrdf.rendering.tables import render_tables
from torchbrdf.transport.harmonic.cache import transport_of

SIZE = 32
TURNS = {"as it is": (0.0, 1), "about the vertical": (50.0, 1), "about the view": (50.0, 2)}


def rotation_of(degrees: float, axis: int) -> torch.Tensor:
    sine, cosine = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    rotation = torch.eye(3)
    rotation[i, i] = rotation[j, j] = cosine
    rotation[i, j], rotation[j, i] = -sine, sine
    return rotation


@pytest.fixture(scope="module")
def tables() -> list[MerlTable]:
    return [
        MerlTable.from_function(lambert(0.7, 0.3, 0.1), "matt"),
        MerlTable.from_function(glossy((0.05, 0.1, 0.2), (0.3, 0.2, 0.1), 0.2), "glossy"),
    ]


@pytest.fixture(scope="module")
def relighter(tables: list[MerlTable], half_grid: None) -> Relighter:
    """The two materials themselves, and a mixture of them."""
    library = MaterialLibrary.from_tables(tables)
    weights = torch.zeros(3, 6, 3)
    for channel in range(3):
        weights[0, channel, channel] = weights[1, 3 + channel, channel] = 1
        weights[2, [channel, 3 + channel], channel] = 0.5
    return Relighter(transport_of(library), weights, ("matt", "glossy", "half"), LightProbe.default(64), SIZE)


@pytest.mark.parametrize("turn", TURNS)
def test_against_the_sampled_transport(relighter: Relighter, tables: list[MerlTable], turn: str) -> None:
    """Within 3 %: pixels show their centres, not means over their area."""
    rotation = rotation_of(*TURNS[turn])
    found = relighter.render(rotation)
    expected = render_tables(tables, relighter.probe.rotated(rotation), SphereView(SIZE))
    for image, sampled in zip(found[:2], expected, strict=True):
        assert (image - sampled).norm() < 0.03 * sampled.norm()


def test_linear_in_the_weights(relighter: Relighter) -> None:
    matt, glossy_one, half = relighter.render(torch.eye(3))
    torch.testing.assert_close(half, (matt + glossy_one) / 2, rtol=1e-3, atol=1e-4)


def test_outside_the_sphere_is_black(relighter: Relighter) -> None:
    found = relighter.render(torch.eye(3))
    assert found.shape == (3, 3, SIZE, SIZE)
    assert bool((found[:, :, ~relighter.mask[0]] == 0).all())
    assert bool((found[:, :, relighter.mask[0]] > 0).all())


def test_the_mirror_ball_shows_the_light_where_a_mirror_would(relighter: Relighter) -> None:
    """A lamp behind the camera in the middle; turned to the right, on the right."""
    radiance = torch.full((3, 32, 64), 0.01)
    radiance[:, 15:17, 31:33] = 100  # +Z
    probe = LightProbe(radiance)
    lamp = Relighter(relighter.transport, torch.zeros(1, 6, 3), ("none",), probe, 33)
    for degrees, column in ((0.0, 16.0), (60.0, 24.0)):
        ball = lamp.mirror_ball(rotation_of(degrees, 1))[0]
        centre = (ball.sum(0) * torch.arange(33)).sum() / ball.sum()
        assert float(centre) == pytest.approx(column, abs=1.5)


def test_a_result_is_shown_of_its_own_library_alone(tiny_library: MaterialLibrary) -> None:
    """Another order of the same materials has as many columns."""
    probe = LightProbe.default(32)
    basis = render_basis(tiny_library, probe, SphereView(8), samples=16)
    estimator = BRDFEstimator(basis, MaterialClasses.single(tiny_library))
    photograph = basis.image(tiny_library.names[0])
    names = tiny_library.names
    for other in (tiny_library.subset(names[::-1]), tiny_library.without(names[0])):
        with pytest.raises(ValueError, match=r"^this library is not the one that the basis images were rendered with$"):
            Relighter.of(other, estimator(photograph), probe, SIZE)
    several = r"^Relighter\.of needs a single reconstruction, this holds a batch \(2,\); pick one: result\[i\]$"
    with pytest.raises(ValueError, match=several):
        Relighter.of(tiny_library, estimator(torch.stack([photograph, photograph])), probe, SIZE)
