from dataclasses import replace

import pytest
import torch
from torch import Tensor

from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import above_horizon
from torchbrdf.estimation.classes import MaterialClasses, Mixture
from torchbrdf.estimation.estimator import BRDFEstimator
from torchbrdf.estimation.image_space import ImageSpace
from torchbrdf.estimation.posterior import TAIL, UNMODELLED, Moments, Posterior
from torchbrdf.estimation.priors import PriorBank, prior_variances
from torchbrdf.transport.basis_images import BasisImages

N, PIXELS = 12, 50
SHARES = {(0, 1): 0.2, (0, 4): 0.1, (1, 7): 0.3, (4, 0): 0.25, (7, 8): 0.15}
"""Prior and penalty -> probability: two penalties of one prior, classes with members missing, both ends of the grid."""


def random(*shape: int, seed: int = 0) -> Tensor:
    """Uniform in [0, 1], float64."""
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def planned(rank: int | None = None) -> Posterior:
    """A posterior with the SHARES; the second of two photographs."""
    packed = random(N, 3, PIXELS) ** 3
    if rank is not None:  # basis images that a photograph cannot tell apart
        packed = torch.einsum("nk,ksp->nsp", random(N, rank, seed=5), packed[:rank])
    space = ImageSpace.of(packed, [PIXELS])
    membership = torch.arange(N) % 3 == torch.arange(3)[:, None]
    bank = PriorBank.of(space, prior_variances(membership, 0.5 + random(N, seed=1), space))
    y = torch.einsum("bsn,nsp->bsp", random(2, 3, N, seed=2), packed) * (1 + 0.1 * random(2, 3, PIXELS, seed=3))
    shares = torch.zeros(len(bank.variances), bank.penalties.shape[-1], dtype=torch.float64)
    for pair, share in SHARES.items():
        shares[pair] = share
    return Posterior(bank.explain(y), shares, row=1)


def gaussians(posterior: Posterior) -> list[tuple[float, Tensor, Tensor]]:
    """Share, mean (3, n) and covariance (3, n, n) of every part, by dense solves in the weights that S allows.

    y = R w + noise of variance s^2, w ~ N(a mu, s^2 / lambda S): the textbook formulas, without any factor.
    """
    found, row = posterior.explanation, posterior.row
    bank = found.bank
    parts = []
    for (m, k), share in SHARES.items():
        mean, covariance = torch.zeros(3, N).double(), torch.zeros(3, N, N).double()
        free = torch.nonzero(bank.variances[m] > 0).ravel()
        for c in range(3):
            r = bank.space.r[c][:, free]
            noise = found.quadratic[row, m, c, k] / found.bank.independent_pixels
            around = found.brightness[row, m, c] * bank.means[m, free]
            # the photograph's coordinates, from its deviation from the mean image
            z = bank.vectors[m, c] @ found.deviation[row, m, c] + r @ around
            precision = (r.mT @ r + bank.penalties[m, c, k] * torch.diag(1 / bank.variances[m, free])) / noise
            inverse = torch.linalg.inv(precision)
            covariance[c][free[:, None], free] = inverse
            mean[c, free] = around + inverse @ r.mT @ (z - r @ around) / noise
        parts.append((share, mean, covariance))
    return parts


@pytest.mark.parametrize("rank", [None, 5])
def test_moments_are_those_of_the_dense_mixture(rank):
    posterior = planned(rank)
    parts = gaussians(posterior)
    mean = sum(share * one for share, one, _ in parts)
    second = sum(share * (cov + one[..., None] * one[:, None]) for share, one, cov in parts)
    covariance = second - mean[..., None] * mean[:, None]
    torch.testing.assert_close(posterior.moments.mean, mean, rtol=1e-6, atol=1e-6 * float(mean.abs().max()))
    largest = float(covariance.abs().max())
    torch.testing.assert_close(posterior.moments.covariance, covariance, rtol=1e-5, atol=1e-7 * largest)


def test_standard_deviations_are_those_of_samples():
    posterior = planned()
    g = torch.Generator().manual_seed(7)
    rows = torch.randn(20, N, generator=g, dtype=torch.float64)
    samples = []
    for share, mean, covariance in gaussians(posterior):
        count = round(100_000 * share)
        normal = torch.randn(3, N, count, generator=g, dtype=torch.float64)
        samples.append(mean[..., None] + torch.linalg.cholesky(covariance + 1e-14 * torch.eye(N)) @ normal)
    drawn = rows @ torch.cat(samples, -1)
    expected = torch.sqrt(drawn.var(-1) + (UNMODELLED * drawn.mean(-1)) ** 2)
    torch.testing.assert_close(posterior.std(rows), expected, rtol=0.02, atol=0)


def test_std_knows_the_covariance_and_a_share_of_the_mean():
    posterior = planned()
    rows = random(3, 40, N, seed=8)
    moments = posterior.moments
    variance = torch.einsum("sin,snm,sim->si", rows, moments.covariance, rows)
    unmodelled = UNMODELLED * torch.einsum("sin,sn->si", rows, moments.mean)
    expected = torch.sqrt(variance + unmodelled**2)
    torch.testing.assert_close(posterior.std(rows), expected, rtol=1e-6, atol=0)
    torch.testing.assert_close(posterior.std(rows.float()), expected.float(), rtol=1e-3, atol=0)
    torch.testing.assert_close(posterior.std(rows[1])[1], expected[1], rtol=1e-6, atol=0)


def test_directions_that_nothing_leaves_open_have_no_variance():
    """Rounding may take an eigenvalue of the covariance below zero; a standard deviation is never NaN."""
    posterior = planned()
    v = random(N, seed=4)
    singular = Moments(torch.zeros(3, N).double(), (torch.outer(v, v) - 1e-17 * torch.eye(N)).repeat(3, 1, 1))
    object.__setattr__(posterior, "moments", singular)
    across = random(N, seed=6)
    across -= v * (across @ v) / (v @ v)
    std = posterior.std(torch.stack([v, across]))
    torch.testing.assert_close(std[:, 0], (v @ v).expand(3))
    assert (std[:, 1] <= 1e-6 * float(v.norm())).all()


def test_unlikely_priors_are_left_out_and_the_others_share_all():
    posterior = planned()
    rare = posterior.probabilities.clone() * (1 - 1e-4)
    rare[9, 5] = 1e-4
    found = replace(posterior, probabilities=rare)
    torch.testing.assert_close(found.moments.mean, posterior.moments.mean, rtol=1e-12, atol=0)
    torch.testing.assert_close(found.moments.covariance, posterior.moments.covariance, rtol=1e-9, atol=1e-15)


def test_a_compressed_factor_loses_little_of_rows_like_those_it_saw():
    posterior = planned()
    spread = torch.logspace(0, -5, N, dtype=torch.float64)  # rows that hardly move in most directions
    turn = torch.linalg.qr(torch.randn(N, N, generator=torch.Generator().manual_seed(1)).double()).Q
    rows = torch.randn(500, N, generator=torch.Generator().manual_seed(2)).double() * spread @ turn
    rows = rows * torch.logspace(-3, 3, 500, dtype=torch.float64)[:, None]  # bright and dark cells count alike
    factor = posterior.compressed(rows)
    assert factor.shape[-1] < N - 2
    exact, short = posterior.std(rows), posterior.std(rows, factor)
    assert (short <= exact * (1 + 1e-6)).all()
    assert ((short / exact) ** 2).mean() >= 1 - 1.5 * TAIL
    assert (short / exact).median() > 0.99


def classes_of(library: MaterialLibrary) -> MaterialClasses:
    """Materials in turn in three classes."""
    labels = torch.arange(library.n) // 3 % 3
    one_hot = torch.nn.functional.one_hot(labels).double()
    identity = torch.eye(4).double().repeat(3, 1, 1)
    mixture = Mixture(one_hot.mean(0), torch.zeros(3, 4).double(), identity, one_hot, (0.0,), True)
    return MaterialClasses(mixture, library.names, library.source, library.gram.diagonal().sqrt())


def images_of(library: MaterialLibrary, seed: int = 0) -> BasisImages:
    """Pictures of every basis BRDF, each pixel a mean of some of its cells."""
    lit = torch.nonzero(above_horizon().ravel()).ravel()
    cells = lit[torch.randint(len(lit) // 8, (3 * 60 * 4,), generator=torch.Generator().manual_seed(seed))]
    packed = library.rows(cells).reshape(3, 60, 4, library.n).mean(2).permute(2, 0, 1)
    mask = torch.ones(1, 6, 10, dtype=torch.bool)
    return BasisImages(packed.contiguous(), mask, library.names, library.source, f"P{seed}", "V")


@pytest.fixture(scope="module")
def fitted(tiny_library: MaterialLibrary) -> tuple[BRDFEstimator, Tensor]:
    """An estimator and three photographs, mixtures of materials with noise."""
    basis = images_of(tiny_library)
    weights = random(3, 3, tiny_library.n, seed=9) ** 8
    photographs = torch.einsum("bsn,nsp->bsp", weights, basis.packed.double())
    photographs = photographs * (1 + 0.02 * random(3, 3, 60, seed=10))
    return BRDFEstimator(basis, classes_of(tiny_library)), basis.unpack(photographs)


def test_image_std_of_another_probe(tiny_library, fitted):
    estimator, photographs = fitted
    result = estimator(photographs)[1]
    basis = images_of(tiny_library, seed=1)
    expected = result.posterior.std(basis.packed.double().permute(1, 2, 0))
    found = result.image_std(basis)
    assert found.shape == (3, 6, 10)
    torch.testing.assert_close(basis.pack(found).double(), expected, rtol=1e-3, atol=0)


def test_every_photograph_of_a_batch_has_its_own_posterior(tiny_library, fitted):
    estimator, photographs = fitted
    basis = images_of(tiny_library, seed=1)
    masks = torch.ones(3, 1, 6, 10, dtype=torch.bool)
    masks[1, :, :3] = False
    together = estimator(photographs, masks)
    for i in (2, 1, 0):
        alone = estimator(photographs[i], masks[i])
        assert alone.posterior.explanation.bank.space.scale.shape[-1] == (30 if i == 1 else 60)
        torch.testing.assert_close(together[i].image_std(basis), alone.image_std(basis), rtol=1e-4, atol=0)


def test_std_follows_the_scale_of_the_photograph(tiny_library, fitted):
    estimator, photographs = fitted
    basis = images_of(tiny_library, seed=1)
    one = estimator(photographs[0]).image_std(basis)
    for factor in (2.0**-40, 2.0**40):
        scaled = estimator(photographs[0] * factor).image_std(basis)
        torch.testing.assert_close(scaled / factor, one, rtol=1e-5, atol=0)


def test_brdf_std_in_every_cell(tiny_library, fitted):
    estimator, photographs = fitted
    result = estimator(photographs[2])
    found = result.brdf_std(tiny_library)
    lit = above_horizon()
    assert found.shape == (90, 90, 180, 3)
    assert (found[~lit] == 0).all()
    cells = torch.nonzero(lit.ravel()).ravel()[7::331]
    exact = result.posterior.std(tiny_library.rows(cells).double()).T
    ratio = found.reshape(-1, 3)[cells] / exact
    assert ratio.max() < 1.001
    assert ratio.median() > 0.99
    assert ratio.min() > 0.8


def test_rows_and_map_rows_are_the_tables(tiny_library):
    some = tiny_library.subset([tiny_library.names[i] for i in (7, 2, 5)])
    cells = torch.nonzero(above_horizon().ravel()).ravel()[3::1009]
    tables = [some.table(name).values.reshape(-1, 3)[cells] for name in some.names]
    torch.testing.assert_close(some.rows(cells).double(), torch.cat(tables, 1).double(), rtol=1e-6, atol=0)
    mapped = some.map_rows(lambda rows: rows[:, [8, 0, 4]])
    assert mapped.shape == (90, 90, 180, 3)
    torch.testing.assert_close(mapped.reshape(-1, 3)[cells], some.rows(cells)[:, [8, 0, 4]])


def test_a_posterior_must_be_there_and_belong(tiny_library, fitted):
    estimator, photographs = fitted
    basis = images_of(tiny_library, seed=1)
    result = estimator(photographs)
    with pytest.raises(ValueError, match=r"posterior needs a single reconstruction, this holds a batch \(3,\)"):
        result.image_std(basis)
    with pytest.raises(ValueError, match="these basis images show another library than those of the photograph"):
        result[0].image_std(replace(basis, library="another"))
    with pytest.raises(ValueError, match="this library is not the one"):
        result[0].brdf_std(tiny_library.without(tiny_library.names[0]))
    fixed = BRDFEstimator(images_of(tiny_library), estimator.classes, penalty=0.1)(photographs[0])
    with pytest.raises(ValueError, match='a fixed penalty has no posterior; make the estimator with penalty="auto"'):
        fixed.image_std(basis)
