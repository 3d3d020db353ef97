"""Cubic B-splines: partition of unity, SciPy's as an oracle, both ends, the banded dual."""

import math

import pytest
import torch
from scipy.interpolate import BSpline

from torchbrdf.transport.harmonic.splines import (
    SUPPORT,
    banded_dual,
    banded_product,
    design_matrix,
    gram,
    spline_weights,
)

N = 24
REACH = 6


def quadrature(n: int, places: int = 8) -> tuple[torch.Tensor, torch.Tensor]:
    """The splines at the middles of fine steps, and a measure that vanishes at 0 like that of a sphere."""
    x = (torch.arange(n * places, dtype=torch.float64) + 0.5) / places
    return design_matrix(x, n), torch.sin(x * (math.pi / 2 / n)) / places


@pytest.fixture(scope="module")
def products() -> torch.Tensor:
    return gram(*quadrature(N))


@pytest.fixture(scope="module")
def dual(products: torch.Tensor) -> torch.Tensor:
    return banded_dual(products, REACH)


class TestValues:
    def test_partition_of_unity(self) -> None:
        x = torch.linspace(-3, 5, 997, dtype=torch.float64)
        weights = spline_weights(x)
        assert weights.shape == (997, SUPPORT)
        assert float(weights.min()) >= 0
        torch.testing.assert_close(weights.sum(-1), torch.ones_like(x), rtol=0, atol=1e-14)

    @pytest.mark.parametrize("n", [1, 2, 7, N])
    def test_agree_with_scipy(self, n: int) -> None:
        """Function j of n + 3 stands on the knots j - 3, ..., j + 1."""
        x = torch.linspace(0, n, 301, dtype=torch.float64)[:-1]
        found = design_matrix(x, n)
        for j in range(n + 3):
            element = BSpline.basis_element(range(j - 3, j + 2), extrapolate=False)
            expected = torch.nan_to_num(torch.from_numpy(element(x.numpy())))
            torch.testing.assert_close(found[:, j], expected, rtol=0, atol=1e-14)

    def test_shape_of_a_batch(self) -> None:
        x = torch.rand(3, 5, generator=torch.Generator().manual_seed(0))
        torch.testing.assert_close(spline_weights(x)[2, 4], spline_weights(x[2, 4]))


class TestDesignMatrix:
    def test_both_ends(self) -> None:
        ends = design_matrix(torch.tensor([0.0, N]), N)
        expected = torch.zeros(2, N + 3, dtype=torch.float64)
        expected[0, :3] = expected[1, -3:] = torch.tensor([1.0, 4.0, 1.0], dtype=torch.float64) / 6
        torch.testing.assert_close(ends, expected, rtol=0, atol=1e-15)

    def test_continuous_up_to_the_right_end(self) -> None:
        near = design_matrix(torch.tensor([N - 1e-7, N], dtype=torch.float64), N)
        torch.testing.assert_close(near[0], near[1], rtol=0, atol=1e-6)

    def test_places_outside_count_as_the_ends(self) -> None:
        outside = design_matrix(torch.tensor([-0.5, N + 0.5]), N)
        assert torch.equal(outside, design_matrix(torch.tensor([0.0, N]), N))

    def test_rows_sum_to_one(self) -> None:
        x = torch.rand(500, generator=torch.Generator().manual_seed(1), dtype=torch.float64) * N
        torch.testing.assert_close(design_matrix(x, N).sum(1), torch.ones_like(x), rtol=0, atol=1e-14)

    def test_line_is_kept(self) -> None:
        """Spline j stands about the knot j - 1; with these as coefficients the sum is x itself."""
        x = torch.linspace(0, N, 77, dtype=torch.float64)
        coefficients = torch.arange(N + 3, dtype=torch.float64) - 1
        torch.testing.assert_close(design_matrix(x, N) @ coefficients, x, rtol=0, atol=1e-12)


class TestBandedDual:
    def test_gram_is_symmetric_and_its_rows_are_the_measure(self, products: torch.Tensor) -> None:
        design, measure = quadrature(N)
        torch.testing.assert_close(products, products.T)
        torch.testing.assert_close(products.sum(1), design.T @ measure)

    @pytest.mark.parametrize("power", [0, 1, 2, 3])
    def test_cubics_are_kept_exactly(self, products: torch.Tensor, dual: torch.Tensor, power: int) -> None:
        coefficients = torch.linspace(-1, 1, len(products), dtype=torch.float64) ** power
        torch.testing.assert_close(dual @ (products @ coefficients), coefficients, rtol=0, atol=1e-9)

    def test_others_are_not(self, products: torch.Tensor, dual: torch.Tensor) -> None:
        """The band leaves an error elsewhere: else the test before would say nothing."""
        rough = torch.linspace(-1, 1, len(products), dtype=torch.float64).mul(20).cos()
        assert float((dual @ (products @ rough) - rough).abs().max()) > 1e-6

    def test_band(self, dual: torch.Tensor) -> None:
        i, j = torch.nonzero(dual, as_tuple=True)
        inside = (i >= REACH) & (i < len(dual) - REACH)
        assert int((i - j).abs()[inside].max()) == REACH
        assert int((i - j).abs().max()) == 2 * REACH

    def test_approximates_the_inverse(self, products: torch.Tensor, dual: torch.Tensor) -> None:
        one = torch.eye(len(products), dtype=torch.float64)
        errors = [float((banded_dual(products, reach) @ products - one).abs().max()) for reach in (3, 6, 9)]
        assert errors[0] > 2 * errors[1] > 4 * errors[2]
        assert errors[2] < 0.05

    def test_whole_matrix_is_the_inverse(self, products: torch.Tensor) -> None:
        found = banded_dual(products, len(products)) @ products
        torch.testing.assert_close(found, torch.eye(len(products), dtype=torch.float64), rtol=0, atol=1e-6)


def test_a_banded_product_is_a_product() -> None:
    generator = torch.Generator().manual_seed(0)
    matrix = torch.rand(200, 90, generator=generator).tril(10).triu(-70)  # the last rows are all zero
    values = torch.rand(2, 90, 3, generator=generator)
    torch.testing.assert_close(banded_product(matrix, values), matrix @ values)
