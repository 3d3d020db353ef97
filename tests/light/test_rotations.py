"""Rotation vectors: the exponential map as an oracle, its inverse, turns by nothing and by half a turn."""

from math import pi

import pytest
import torch
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

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


LENGTHS = [0.0, 1e-12, 1e-5, 1e-3, 0.1, 2.0, 3.1]


@pytest.mark.parametrize("axis", [X, -Y, Z, torch.tensor([0.6, 0.0, -0.8]), torch.tensor([-0.48, 0.6, 0.64])])
@pytest.mark.parametrize("length", [*LENGTHS, 2e-3, pi - 1e-7, pi + 1e-7, 7.0])
def test_agrees_with_scipy(axis: torch.Tensor, length: float) -> None:
    vector = length * axis.double()
    rotation = rotation_of(vector)
    expected = Rotation.from_rotvec(vector.numpy())
    torch.testing.assert_close(rotation, torch.from_numpy(expected.as_matrix()), rtol=0, atol=1e-14)
    vector = torch.from_numpy(Rotation.from_matrix(rotation.numpy()).as_rotvec())
    torch.testing.assert_close(rotation_vector(rotation), vector, rtol=0, atol=1e-12)


@pytest.mark.parametrize("length", LENGTHS)
def test_gradients(length: float) -> None:
    vector = (length * torch.tensor([-0.48, 0.6, 0.64], dtype=torch.float64)).requires_grad_()
    assert torch.autograd.gradcheck(rotation_of, vector)
    assert torch.autograd.gradcheck(lambda v: rotation_vector(rotation_of(v)), vector)
    there_and_back = torch.autograd.functional.jacobian(lambda v: rotation_vector(rotation_of(v)), vector)
    torch.testing.assert_close(there_and_back, torch.eye(3, dtype=torch.float64), rtol=0, atol=1e-9)


@pytest.mark.parametrize("axis", [X, Y, Z])
def test_gradients_near_half_a_turn(axis: torch.Tensor) -> None:
    """Whichever component of the quaternion is the largest."""
    vector = (3.0 * torch.nn.functional.normalize(axis + 0.1, dim=0)).requires_grad_()
    assert torch.autograd.gradcheck(lambda v: rotation_vector(rotation_of(v)), vector)


def test_gradients_are_in_the_type_of_what_was_given() -> None:
    vector = torch.tensor([0.1, 0.2, 0.3], requires_grad=True)
    rotation_vector(rotation_of(vector).float()).sum().backward()
    torch.testing.assert_close(vector.grad, torch.ones(3))


def test_bad_input() -> None:
    with pytest.raises(ValueError, match=r"^a rotation vector must be \(3,\), got \(2, 3\)$"):
        rotation_of(torch.zeros(2, 3))
    with pytest.raises(ValueError, match=r"^rotation must be orthonormal with determinant \+1, got determinant -1"):
        rotation_vector(-torch.eye(3))
