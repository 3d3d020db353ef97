import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st
from torch import Tensor

from torchbrdf.estimation.solvers.ridge_regression import GramFactor, balance, prior_mean, ridge, ridge_lstsq


def problem(c: int = 7, pixels: int = 40, batch: tuple[int, ...] = (), seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """Basis images (c, 3, P), photographs (*batch, 3, P), and a prior that is not constant."""
    g = torch.Generator().manual_seed(seed)
    basis = torch.rand(c, 3, pixels, generator=g, dtype=torch.float64)
    image = torch.rand(*batch, 3, pixels, generator=g, dtype=torch.float64)
    return basis, image, torch.rand(c, generator=g, dtype=torch.float64)


def by_factor(basis: Tensor, image: Tensor, prior: Tensor, strength: Tensor) -> Tensor:
    projection = torch.einsum("csp,...sp->...sc", basis, image)
    return ridge(GramFactor.of(basis), projection, prior, strength)


SOLVERS = [pytest.param(by_factor, id="factored"), pytest.param(ridge_lstsq, id="lstsq")]


@pytest.mark.parametrize("solver", SOLVERS)
class TestBothSolvers:
    @pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
    def test_normal_equations(self, solver, batch: tuple[int, ...]):
        """(Y^T Y + strength I) w = Y^T y + strength prior, one small system at a time."""
        basis, image, prior = problem(batch=batch)
        strength = torch.rand(*batch, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(3)) + 0.01
        weights = solver(basis, image, prior, strength)
        assert weights.shape == (*batch, 3, 7)
        for index in np.ndindex(*batch, 3):
            y = basis[:, index[-1]].T
            left = y.T @ y + strength[index] * torch.eye(7, dtype=torch.float64)
            right = y.T @ image[index] + strength[index] * prior
            assert torch.allclose(weights[index], torch.linalg.solve(left, right), rtol=1e-9, atol=1e-11)

    @given(st.integers(0, 10**6), st.integers(1, 9), st.integers(1, 12), st.floats(-6, 4))
    def test_minimises_what_it_says(self, solver, seed: int, c: int, pixels: int, decade: float):
        """More unknowns than pixels included: no step away from the solution lowers the sum."""
        basis, image, prior = problem(c, pixels, seed=seed)
        strength = torch.full((3,), 10**decade, dtype=torch.float64)

        def cost(w: Tensor) -> Tensor:
            misfit = (torch.einsum("csp,sc->sp", basis, w) - image).square().sum(-1)
            return misfit + strength * (w - prior).square().sum(-1)

        weights = solver(basis, image, prior, strength)
        lowest = cost(weights)
        g = torch.Generator().manual_seed(seed + 1)
        for scale in (1e-2, 1.0):
            step = scale * torch.randn(3, c, generator=g, dtype=torch.float64)
            assert (cost(weights + step) >= lowest * (1 - 1e-12)).all()

    def test_without_penalty_it_is_least_squares(self, solver):
        basis, image, prior = problem()
        weights = solver(basis, image, prior, torch.zeros(3, dtype=torch.float64))
        for s in range(3):
            expected = np.linalg.lstsq(basis[:, s].T.numpy(), image[s].numpy(), rcond=None)[0]
            np.testing.assert_allclose(weights[s].numpy(), expected, rtol=1e-8, atol=1e-10)

    def test_without_penalty_underdetermined_gives_the_smallest_norm(self, solver):
        basis, image, prior = problem(c=20, pixels=8)
        weights = solver(basis, image, prior, torch.zeros(3, dtype=torch.float64))
        for s in range(3):
            expected = np.linalg.lstsq(basis[:, s].T.numpy(), image[s].numpy(), rcond=None)[0]
            np.testing.assert_allclose(weights[s].numpy(), expected, rtol=1e-6, atol=1e-8)

    def test_without_penalty_duplicate_columns_share_the_weight(self, solver):
        """Rank 7 of 14 columns: numpy's smallest-norm solution halves each weight."""
        basis, image, prior = problem()
        twice, prior = torch.cat([basis, basis]), torch.cat([prior, prior])
        weights = solver(twice, image, prior, torch.zeros(3, dtype=torch.float64))
        single = solver(basis, image, prior[:7], torch.zeros(3, dtype=torch.float64))
        assert torch.allclose(weights, torch.cat([single, single], -1) / 2, rtol=1e-6, atol=1e-8)
        expected = np.linalg.lstsq(twice[:, 1].T.numpy(), image[1].numpy(), rcond=None)[0]
        np.testing.assert_allclose(weights[1].numpy(), expected, rtol=1e-6, atol=1e-8)

    def test_zero_columns_stay_at_their_prior(self, solver):
        basis, image, prior = problem()
        basis[[1, 4]] = 0
        weights = solver(basis, image, prior, torch.full((3,), 0.3, dtype=torch.float64))
        assert torch.allclose(weights[:, [1, 4]], prior[[1, 4]].expand(3, 2), rtol=1e-12)
        weights = solver(basis, image, prior, torch.zeros(3, dtype=torch.float64))
        assert float(weights[:, [1, 4]].abs().max()) < 1e-12

    def test_infinite_penalty_gives_the_prior(self, solver):
        basis, image, prior = problem()
        weights = solver(basis, image, prior, torch.full((3,), 1e14, dtype=torch.float64))
        assert torch.allclose(weights, prior.expand(3, 7), rtol=1e-10)

    def test_channels_and_photographs_have_penalties_of_their_own(self, solver):
        basis, image, prior = problem(batch=(2,))
        strength = torch.tensor([[0.0, 1e-3, 1.0], [10.0, 0.1, 0.0]], dtype=torch.float64)
        together = solver(basis, image, prior, strength)
        for b in range(2):
            for s in range(3):
                alone = solver(basis, image[b], prior, strength[b, s].expand(3))[s]
                assert torch.allclose(together[b, s], alone, rtol=1e-9, atol=1e-12)

    @pytest.mark.parametrize("penalty", [1e-2, 1e-6])
    def test_float32_basis_images_lose_nothing_more(self, solver, penalty: float):
        """Small penalties and nearly parallel columns: a float32 Gram matrix would be wrong in the first digit."""
        g = torch.Generator().manual_seed(0)
        common = torch.rand(3, 60, generator=g)
        basis = common + 1e-3 * torch.rand(8, 3, 60, generator=g)
        image = torch.rand(3, 60, generator=g).double()
        prior = prior_mean(8, image)
        strength = torch.full((3,), penalty, dtype=torch.float64)
        y = basis.double()
        for s in range(3):
            tall = np.vstack([y[:, s].T.numpy(), np.sqrt(penalty) * np.eye(8)])
            right = np.concatenate([image[s].numpy(), np.sqrt(penalty) * prior.numpy()])
            expected = np.linalg.lstsq(tall, right, rcond=None)[0]
            found = solver(basis.double() if solver is by_factor else basis, image, prior, strength)
            assert found.dtype == torch.float64
            np.testing.assert_allclose(found[s].numpy(), expected, rtol=1e-5, atol=1e-7)

    def test_gradient_reaches_the_image(self, solver):
        basis, image, prior = problem(c=4, pixels=9)
        image.requires_grad_()

        def weights(image: Tensor) -> Tensor:
            return solver(basis, image, prior, balance(0.5, image.square().sum(-1), 4))

        assert torch.autograd.gradcheck(weights, image)


def test_factor_takes_float32_images_in_float64():
    basis, _, _ = problem()
    factor = GramFactor.of(basis.float())
    assert factor.values.dtype == factor.vectors.dtype == torch.float64
    gram = factor.vectors @ torch.diag_embed(factor.values) @ factor.vectors.mT
    y = basis.float().double().transpose(0, 1)
    assert torch.allclose(gram, y @ y.mT, rtol=1e-12)


def test_balance_and_prior_by_hand():
    """Eq. 25: lambda |y|^2 / c, 0.5 x 12 / 3; eq. 24: 1 / c."""
    energy = torch.tensor([12.0, 0.0, 3.0]).double()
    assert balance(0.5, energy, 3).tolist() == [2.0, 0.0, 0.5]
    assert prior_mean(4, energy).tolist() == [0.25] * 4
    assert prior_mean(4, energy).dtype == torch.float64
