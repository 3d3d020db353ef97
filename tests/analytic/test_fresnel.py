import numpy as np
import pytest
import torch
from torch import Tensor

from torchbrdf.analytic.fresnel import conductor, dielectric, normal_incidence, schlick

COSINES = torch.linspace(0.001, 1, 400, dtype=torch.float64)


def number(value: float) -> Tensor:
    return torch.tensor(value, dtype=torch.float64)


def by_complex_numbers(cosine: Tensor, eta: float, k: float) -> Tensor:
    """The textbook: amplitudes of both polarisations, with a complex index and Snell's law."""
    c, index = cosine.numpy(), complex(eta, -k)
    transmitted = np.sqrt(1 - (1 - c**2) / index**2)
    across = (c - index * transmitted) / (c + index * transmitted)
    along = (index * c - transmitted) / (index * c + transmitted)
    return torch.from_numpy((np.abs(across) ** 2 + np.abs(along) ** 2) / 2)


@pytest.mark.parametrize("f0", [0.0, 0.04, 0.9, 1.0])
def test_schlick_goes_from_f0_to_one(f0: float):
    cosines = torch.tensor([1.0, 0.5, 0.0], dtype=torch.float64)
    expected = [f0, f0 + (1 - f0) / 32, 1.0]
    torch.testing.assert_close(schlick(cosines, number(f0)), torch.tensor(expected, dtype=torch.float64))


@pytest.mark.parametrize("eta", [1.01, 1.33, 1.5, 2.4, 100.0])
def test_dielectric_is_the_textbook(eta: float):
    expected = by_complex_numbers(COSINES, eta, 0.0)
    torch.testing.assert_close(dielectric(COSINES, number(eta)), expected, rtol=1e-9, atol=1e-12)


def test_dielectric_reflects_4_percent_at_normal_incidence_and_all_at_grazing():
    assert float(dielectric(number(1.0), number(1.5))) == pytest.approx(0.04, rel=1e-12)
    assert float(dielectric(number(0.0), number(1.5))) == pytest.approx(1.0, abs=1e-5)


def test_at_brewsters_angle_only_one_polarisation_is_reflected():
    eta = 1.5
    cosine = 1 / np.sqrt(1 + eta**2)
    across = (1 - eta**2) / (1 + eta**2)
    assert float(dielectric(number(cosine), number(eta))) == pytest.approx(across**2 / 2, rel=1e-9)


def test_single_precision_keeps_its_digits_for_an_index_near_1():
    eta = torch.tensor(1.01)
    exact = dielectric(COSINES, eta.double())
    torch.testing.assert_close(dielectric(COSINES.float(), eta).double(), exact, rtol=2e-5, atol=0)


@pytest.mark.parametrize(("eta", "k"), [(0.2, 3.9), (1.1, 2.1), (2.9, 3.1), (0.05, 10.0), (1.5, 0.0), (1.5, 1e-3)])
def test_conductor_is_the_textbook(eta: float, k: float):
    expected = by_complex_numbers(COSINES, eta, k)
    torch.testing.assert_close(conductor(COSINES, number(eta), number(k)), expected, rtol=1e-7, atol=1e-9)


def test_a_conductor_that_does_not_absorb_is_a_dielectric():
    eta = number(1.7)
    torch.testing.assert_close(conductor(COSINES, eta, number(0.0)), dielectric(COSINES, eta), rtol=1e-7, atol=1e-9)


def test_no_boundary_reflects_more_than_comes_in():
    eta = torch.logspace(-1.7, 2, 60, dtype=torch.float64)[:, None]
    for k in (0.0, 0.3, 20.0):
        f = conductor(COSINES, eta, number(k))
        assert float(f.min()) >= 0
        assert float(f.max()) <= 1 + 1e-9
    f = dielectric(COSINES, eta.clamp_min(1.01))
    assert 0 <= float(f.min()) <= float(f.max()) <= 1 + 1e-9


def test_normal_incidence_is_the_dielectric_there():
    eta = torch.tensor([1.01, 1.5, 3.0], dtype=torch.float64)
    torch.testing.assert_close(normal_incidence(eta), dielectric(number(1.0), eta))


@pytest.mark.parametrize("function", [schlick, dielectric])
def test_gradients_are_those_of_finite_differences(function):
    parameter = torch.tensor([0.2 if function is schlick else 1.4], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(function, (COSINES[5::40], parameter))


def test_gradients_of_the_conductor_are_those_of_finite_differences():
    at = [torch.tensor([value], dtype=torch.float64, requires_grad=True) for value in (0.4, 2.5)]
    assert torch.autograd.gradcheck(lambda eta, k: conductor(COSINES[5::40], eta, k), at)
