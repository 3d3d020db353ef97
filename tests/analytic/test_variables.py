"""The vector of free numbers: there and back, its bounds, and its derivatives against those of torch."""

from math import exp, log

import numpy as np
import pytest
import torch
from torch import Tensor

from bsdf_cases import interior, numbers, some_geometry
from torchbrdf.analytic import MODELS, AnalyticModel, Parameter, model_of
from torchbrdf.analytic.shading_geometry import ShadingGeometry
from torchbrdf.analytic.variables import FitVariables

ALL = sorted(MODELS)
EITHER = pytest.mark.parametrize("shared", [True, False], ids=["shared", "separate"])


def uneven(variables: FitVariables) -> np.ndarray:
    """A vector within the bounds, no two numbers at the same share of their range."""
    lower, upper = variables.bounds
    return lower + (upper - lower) * np.linspace(0.37, 0.61, len(variables))


@EITHER
@pytest.mark.parametrize("name", ALL)
def test_vector_and_parameters_are_inverse(name: str, shared: bool):
    variables = FitVariables(MODELS[name], shared)
    x = uneven(variables)
    parameters = variables.parameters(torch.from_numpy(x))
    assert list(parameters) == [p.name for p in MODELS[name].parameters]
    for p in MODELS[name].parameters:
        assert parameters[p.name].shape == (3 if p.colour or not shared else 1,)
        assert ((p.lower <= parameters[p.name]) & (parameters[p.name] <= p.upper)).all()
    np.testing.assert_allclose(variables.vector(parameters), x, rtol=1e-12)


@EITHER
@pytest.mark.parametrize("name", ALL)
def test_bounds_are_those_of_the_parameters(name: str, shared: bool):
    variables = FitVariables(MODELS[name], shared)
    for ends, end in zip(variables.bounds, ("lower", "upper"), strict=True):
        assert ends.shape == (len(variables),)
        for p in MODELS[name].parameters:
            value = variables.parameters(torch.from_numpy(ends))[p.name]
            torch.testing.assert_close(value, torch.full_like(value, getattr(p, end)), rtol=1e-12, atol=0)


def test_logarithms_where_the_model_says_so():
    variables = FitVariables(model_of("ggx"))
    parameters = numbers(diffuse=(0.1, 0.2, 0.3), specular=(0.4, 0.5, 0.6), roughness=0.07)
    assert variables.vector(parameters).tolist() == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, log(0.07)])


def test_a_number_of_a_channel_stands_for_all_three_where_they_are_separate():
    variables = FitVariables(model_of("oren-nayar"), shared=False)
    x = variables.vector(numbers(diffuse=(0.1, 0.2, 0.3), roughness=0.7))
    assert x.tolist() == pytest.approx([0.1, 0.2, 0.3, 0.7, 0.7, 0.7])


def test_a_colour_may_be_given_by_one_number():
    x = FitVariables(model_of("oren-nayar")).vector(numbers(diffuse=0.4, roughness=0.7))
    assert x.tolist() == pytest.approx([0.4, 0.4, 0.4, 0.7])


@EITHER
@pytest.mark.parametrize("name", ALL)
def test_starts_lie_within_the_bounds_and_differ(name: str, shared: bool):
    variables = FitVariables(MODELS[name], shared)
    lower, upper = variables.bounds
    starts = np.stack(variables.starts)
    assert ((lower <= starts) & (starts <= upper)).all()
    assert len(np.unique(starts, axis=0)) == len(starts)


def test_starts_are_every_combination():
    model = AnalyticModel(
        "made up",
        lambda geometry, a, b, c: a + b + c,
        (
            Parameter("a", 0, 1, 0.5, starts=(0.2, 0.8)),
            Parameter("b", 0.1, 9, 1, logarithmic=True, starts=(1, 2, 3)),
            Parameter("c", 0, 1, 0.25, colour=True),
        ),
        "none",
    )
    found = {(x[0], round(exp(x[1])), *x[2:]) for x in FitVariables(model).starts}
    assert found == {(a, b, 0.25, 0.25, 0.25) for a in (0.2, 0.8) for b in (1, 2, 3)}


def test_a_model_without_starts_begins_at_its_defaults():
    (x,) = FitVariables(model_of("lambert")).starts
    assert x.tolist() == [0.5, 0.5, 0.5]


def test_bounds_in_words():
    variables = FitVariables(model_of("ggx"))
    inside = numbers(diffuse=(0.1, 0.2, 0.3), specular=(0.4, 0.5, 0.6), roughness=0.07)
    assert variables.at_bounds(variables.vector(inside)) == ()
    ends = numbers(diffuse=(0.1, 0, 0.3), specular=(0.4, 0.5, 1), roughness=0.001)
    assert variables.at_bounds(variables.vector(ends)) == (
        "diffuse of G at its lower bound 0",
        "roughness at its lower bound 0.001",
        "specular of B at its upper bound 1",
    )


@EITHER
@pytest.mark.parametrize("name", ALL)
def test_evaluates_the_model(name: str, shared: bool):
    variables = FitVariables(MODELS[name], shared)
    geometry = some_geometry(40)
    f_r = MODELS[name].evaluate(interior(name), geometry)
    x = variables.vector(interior(name))
    torch.testing.assert_close(variables.evaluate(torch.from_numpy(x), geometry), f_r, rtol=1e-10, atol=0)
    torch.testing.assert_close(variables.linearise(x, geometry).f_r, f_r, rtol=1e-10, atol=0)


def exact_jacobian(variables: FitVariables, x: np.ndarray, geometry: ShadingGeometry) -> Tensor:
    """(3 N, V): backwards, pair by pair."""
    return torch.autograd.functional.jacobian(
        lambda at: variables.evaluate(at, geometry).ravel(), torch.from_numpy(x), vectorize=True
    )


@EITHER
@pytest.mark.parametrize("at_bounds", [False, True], ids=["inside", "upper bounds"])
@pytest.mark.parametrize("name", [name for name in ALL if name != "rough-plastic"])
def test_jacobian_is_that_of_torch(name: str, at_bounds: bool, shared: bool):
    """Every channel has other numbers, so that what a channel owes to another shows."""
    variables = FitVariables(MODELS[name], shared)
    geometry = some_geometry(40, seed=1)
    x = uneven(variables)
    if at_bounds:
        x[::2] = variables.bounds[1][::2]
    at = variables.linearise(x, geometry)
    jacobian = torch.from_numpy(variables.jacobian(at.tangents, at.signs))
    wanted = exact_jacobian(variables, x, geometry)
    assert jacobian.shape == (120, len(variables))
    torch.testing.assert_close(jacobian, wanted, rtol=1e-4, atol=1e-6 * float(wanted.abs().max()))
    if MODELS[name].channels_coupled and not at_bounds:
        red_of_green = wanted.reshape(40, 3, -1)[:, 0, 1]
        assert (red_of_green.abs() > 1e-6).any(), "nothing was coupled here: the case shows nothing"


def test_jacobian_of_plastic():
    """The finite difference from the other side; its quadrature has kinks."""
    variables = FitVariables(MODELS["rough-plastic"])
    geometry = some_geometry(40, seed=1)
    x = uneven(variables)
    at = variables.linearise(x, geometry)
    jacobian = torch.from_numpy(variables.jacobian(at.tangents, at.signs))
    step = 1e-6 * np.eye(len(variables))
    points = torch.from_numpy(np.concatenate([x + step, x - step]))
    ahead, behind = variables.evaluate(points, geometry).flatten(1).chunk(2)
    wanted = ((ahead - behind) / 2e-6).T
    torch.testing.assert_close(jacobian, wanted, rtol=1e-3, atol=1e-4 * float(wanted.abs().max()))


def test_batches_are_one_by_one():
    variables = FitVariables(model_of("principled"), shared=False)
    points = torch.from_numpy(np.stack([uneven(variables), uneven(variables)[::-1] * 0.5 + 0.2]))
    together = variables.evaluate(points, some_geometry(20))
    assert together.shape == (2, 20, 3)
    for one, point in zip(together, points, strict=True):
        torch.testing.assert_close(one, variables.evaluate(point, some_geometry(20)))


def test_evaluation_is_differentiable():
    variables = FitVariables(model_of("principled"), shared=False)
    x = torch.from_numpy(uneven(variables)).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: variables.evaluate(x, some_geometry(6)), x)
