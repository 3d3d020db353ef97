"""Rotation vectors: the exponential map as an oracle, its inverse, turns by nothing and by half a turn."""

from math import pi

import pytest
import torch
from hypothesis import given, strategies as st

from torchbrdf.light.rotations import rotation_angle, rotation_of, rotation_vector
from turns import degrees_between, turn_about

VECTORS = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: sum(x * x for x in v) > 1e-3)
X, Y, Z = torch.eye(3, dtype=torch.float64)


@pytest.mark.parametrize(("axis", "source", "target"), [(X, Y, Z), (Y, Z, X), (Z, X, Y)])
def test_counterclockwise_seen_from_the_tip(axis: torch.Tensor, source: torch.Tensor, target: torch.Tensor) -> None:
    torch.testing.assert_close(rotation_of(axis * pi / 2) @ source, target)


def test_no_turn() -> None:
    assert torch.equal(rotation_of(torch.zeros(3)), torch.eye(3, dtype=torch.float64))
    assert torch.equal(rotation_vector(torch.eye(3)), torch.zeros(3, dtype=torch.float64))


@given(VECTORS, st.floats(0, 720))
def test_is_the_exponential(axis: tuple[float, ...], angle: float) -> None:
    direction = torch.nn.functional.normalize(torch.tensor(axis, dtype=torch.float64), dim=0)
    torch.testing.assert_close(rotation_of(direction * angle * pi / 180), turn_about(axis, angle), rtol=0, atol=1e-10)


@given(VECTORS, st.floats(1e-6, 3.1))
def test_there_and_back(axis: tuple[float, ...], length: float) -> None:
    vector = length * torch.nn.functional.normalize(torch.tensor(axis, dtype=torch.float64), dim=0)
    torch.testing.assert_close(rotation_vector(rotation_of(vector)), vector, rtol=1e-8, atol=1e-12)


@given(VECTORS, st.floats(0, 1000))
def test_no_longer_than_half_a_turn(axis: tuple[float, ...], angle: float) -> None:
    """The long way round is the short way round the other way; at half a turn either will do."""
    rotation = turn_about(axis, angle)
    vector = rotation_vector(rotation)
    assert rotation_angle(rotation) == float(vector.norm()) <= pi + 1e-12
    assert degrees_between(rotation_of(vector), rotation) < 1e-5


def test_of_half_a_turn() -> None:
    vector = rotation_vector(torch.diag(torch.tensor([-1.0, 1.0, -1.0])))
    torch.testing.assert_close(vector.abs(), pi * Y)


def test_single_precision() -> None:
    """float64 comes back, as precise as what went in."""
    vector = torch.tensor([0.1, -0.2, 0.3])
    rotation = rotation_of(vector)
    assert rotation.dtype == torch.float64
    found = rotation_vector(rotation.float())
    assert found.dtype == torch.float64
    torch.testing.assert_close(found, vector.double(), rtol=0, atol=1e-6)


def test_of_a_parameter() -> None:
    """A value, no gradient: `LearnedRotation` is what gradients flow through."""
    assert not rotation_of(torch.zeros(3, requires_grad=True)).requires_grad
    assert not rotation_vector(torch.eye(3, requires_grad=True)).requires_grad
