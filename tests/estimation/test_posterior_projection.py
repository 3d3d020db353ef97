import pytest
import torch
from torch import Tensor

from torchbrdf.estimation import posterior
from torchbrdf.estimation.image_space import ImageSpace
from torchbrdf.estimation.lobe_bounds import LobeBounds
from torchbrdf.estimation.posterior import Moments
from torchbrdf.estimation.posterior_projection import SeenPriors
from torchbrdf.estimation.priors import Explanation, PriorBank, prior_variances
from torchbrdf.estimation.solvers import project_above

N, PIXELS, ROWS = 12, 50, 7


def normal(*shape: int, seed: int = 0) -> Tensor:
    """Float64."""
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.fixture(scope="module")
def bank() -> PriorBank:
    space = ImageSpace.of(normal(N, 3, PIXELS).abs() ** 3, [PIXELS])
    membership = torch.arange(N) % 3 == torch.arange(3)[:, None]
    return PriorBank.of(space, prior_variances(membership, 0.5 + normal(N, seed=1).abs(), space))


@pytest.fixture(scope="module")
def bounds() -> LobeBounds:
    """One row of zeros, and one that an average of all meets."""
    rows = normal(ROWS, N, seed=6)
    rows[2], rows[4] = 0, rows[4].abs()
    return LobeBounds(rows)


@pytest.fixture(scope="module")
def found(bank: PriorBank) -> Explanation:
    """Three photographs that several priors and penalties explain."""
    images = normal(N, 3, PIXELS).abs() ** 3
    y = torch.einsum("bsn,nsp->bsp", normal(3, 3, N, seed=2).abs(), images)
    return bank.explain(y * (1 + 0.3 * normal(3, 3, PIXELS, seed=3)))


def test_nearest_in_the_inverse_covariance(bank, bounds, found, monkeypatch):
    monkeypatch.setattr(posterior, "_LEAST", 0.0)
    projected = SeenPriors.of(bank, bounds).project(found, found.mean)
    assert (found.of_priors > 1e-3).sum(-1).min() > 2
    rows = bounds.rows[(bounds.rows != 0).any(-1)]
    for row, (mean, weights) in enumerate(zip(found.mean, projected.weights, strict=True)):
        moments = Moments.of(found, found.shares[row], row)
        assert (rows @ mean.mT < 0).any()
        factor = torch.linalg.cholesky(torch.linalg.inv(moments.covariance))
        dense = project_above(mean, factor, torch.arange(3), rows, torch.zeros(len(rows)).double())[0]
        torch.testing.assert_close(weights, dense, rtol=1e-6, atol=1e-6 * float(dense.abs().max()))
    assert float(projected.optimality.max()) < 1e-9
    assert (projected.iterations > 0).any(-1).all()


def test_a_feasible_mean_stays_as_it_is(bank, bounds, found):
    mean = found.mean.clone()
    mean[1] = (torch.linalg.pinv(bounds.rows[[0, 1, 3, 4, 5, 6]]) @ torch.ones(6).double()).expand(3, N)
    projected = SeenPriors.of(bank, bounds).project(found, mean)
    assert torch.equal(projected.weights[1], mean[1])
    assert not projected.iterations[1].any()
    assert not torch.equal(projected.weights[0], mean[0])


def test_rows_that_say_nothing(bank, found):
    """Those of a library of matte materials."""
    projected = SeenPriors.of(bank, LobeBounds(torch.zeros(ROWS, N).double())).project(found, found.mean)
    assert torch.equal(projected.weights, found.mean)
    assert not projected.optimality.any()


def test_photographs_do_not_touch_each_other(bank, bounds, found):
    together = SeenPriors.of(bank, bounds).project(found, found.mean).weights
    parts = (found.brightness, found.deviation, found.quadratic, found.log_evidence)
    alone = Explanation(bank, *(part[2:] for part in parts))
    torch.testing.assert_close(SeenPriors.of(bank, bounds).project(alone, alone.mean).weights[0], together[2])


def test_none_at_all(bank, bounds, found):
    parts = (found.brightness, found.deviation, found.quadratic, found.log_evidence)
    none = Explanation(bank, *(part[:0] for part in parts))
    projected = SeenPriors.of(bank, bounds).project(none, torch.zeros(0, 3, N).double())
    assert projected.weights.shape == (0, 3, N)
    assert projected.optimality.shape == (0, 3)
