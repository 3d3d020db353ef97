from math import acos, log

import numpy as np
import pytest
import torch
from torch import Tensor

from torchbrdf.estimation.image_space import ImageSpace
from torchbrdf.estimation.priors.bank import NOISE_FLOOR, PENALTIES, PriorBank
from torchbrdf.estimation.priors.neighbourhoods import NEIGHBOURHOODS, REACHES, farthest_points, image_angles
from torchbrdf.estimation.priors.variances import prior_variances
from torchbrdf.estimation.priors.whole_library import POWER

N, PIXELS = 12, 40
LABELS = (0, 0, 1, 1, 0, 2, 1, 2, 2, 0, 0, 1)
MEMBERSHIP = torch.stack([torch.tensor(LABELS) == j for j in range(3)])
NORMS = torch.linspace(0.5, 3.0, N, dtype=torch.float64) ** 2


def images(pixels: int = PIXELS, seed: int = 0) -> Tensor:
    """Basis images (N, 3, P) float32; those of one class look somewhat alike."""
    g = torch.Generator().manual_seed(seed)
    common = torch.rand(3, 3, pixels, generator=g)
    return 0.2 + common[list(LABELS)] + 0.7 * torch.rand(N, 3, pixels, generator=g)


ERRORS = torch.randn(PIXELS, 2, generator=torch.Generator().manual_seed(5), dtype=torch.float64)


def bank_of(packed: Tensor, errors: Tensor | None = None) -> PriorBank:
    space = ImageSpace.of(packed, [packed.shape[-1]], errors)
    return PriorBank.of(space, prior_variances(MEMBERSHIP, NORMS, space))


def photographs(count: int = 2, seed: int = 3) -> Tensor:
    g = torch.Generator().manual_seed(seed)
    return 0.3 + torch.rand(count, 3, PIXELS, generator=g, dtype=torch.float64)


def weighted_system(bank: PriorBank, y: Tensor, s: int) -> tuple[np.ndarray, np.ndarray]:
    """U R (P, n) of channel s, and a photograph (3, P) over the same scale (P,), both whitened, in numpy."""
    design = (bank.space.u[s].double() @ bank.space.r[s]).numpy()
    target = (y[s] / bank.space.scale[s]).numpy()
    if bank.space.errors is None:
        return design, target
    errors = ERRORS.numpy()
    root = np.linalg.cholesky(np.eye(PIXELS) + errors @ errors.T)
    return np.linalg.solve(root, design), np.linalg.solve(root, target)


def oracle(bank: PriorBank, y: Tensor, m: int, k: int, s: int) -> tuple[float, np.ndarray, float]:
    """Brightness a, weights and quadratic of one prior, penalty and channel, by dense least squares.

    With x = (w - a mu) / sqrt(S), over the members of the prior: min |D sqrt(S) x - (y - a D mu)|^2 + lambda |x|^2.
    """
    design, target = weighted_system(bank, y, s)
    variance, mu, penalty = bank.variances[m].numpy(), bank.means[m].numpy(), float(bank.penalties[m, s, k])
    mean_image = design @ mu
    a = float(mean_image @ target / (mean_image @ mean_image))
    members = variance > 0
    root = np.sqrt(variance[members])
    tall = np.vstack([design[:, members] * root, np.sqrt(penalty) * np.eye(members.sum())])
    right = np.concatenate([target - a * mean_image, np.zeros(members.sum())])
    x = np.linalg.lstsq(tall, right, rcond=None)[0]
    weights = a * mu
    weights[members] += root * x
    residual = target - design @ weights
    return a, weights, float(residual @ residual + penalty * x @ x)


class TestExplain:
    @pytest.mark.parametrize("errors", [None, ERRORS])
    @pytest.mark.parametrize("k", [1, 4, 6, 8])
    def test_brightness_weights_and_quadratic(self, k: int, errors: Tensor | None):
        """Every prior against `numpy.linalg.lstsq` on the augmented system."""
        bank, y = bank_of(images(), errors), photographs()
        found = bank.explain(y)
        for m in range(len(bank.variances)):
            shares = torch.zeros(2, len(bank.variances), len(PENALTIES), dtype=torch.float64)
            shares[:, m, k] = 1
            component = found.components(shares)[:, m]
            for b in range(2):
                for s in range(3):
                    a, weights, quadratic = oracle(bank, y[b], m, k, s)
                    energy = float((y[b, s] / bank.space.scale[s]).square().sum())
                    assert float(found.brightness[b, m, s]) == pytest.approx(a, rel=1e-6)
                    np.testing.assert_allclose(
                        component[b, s].numpy(), weights, rtol=1e-4, atol=1e-6 * abs(weights).max()
                    )
                    floor = NOISE_FLOOR**2 * energy
                    assert float(found.quadratic[b, m, s, k]) == pytest.approx(quadratic + floor, rel=1e-6)

    @pytest.mark.parametrize("errors", [None, ERRORS])
    def test_evidence_is_the_marginal_likelihood_of_a_gaussian(self, errors: Tensor | None):
        """y ~ N(a D mu, sigma^2 (I + D S D^T / lambda)), sigma^2 at its best, `independent_pixels` instead of P.

        1/2 log f: the determinant of I + D S D^T / lambda; its quadratic form is the regularised residual.
        """
        bank, y = bank_of(images(), errors), photographs(1)
        found = bank.explain(y)
        for m in (0, 1, 3, 5, len(bank.variances) - 1):
            for k in (0, 5, 8):
                expected = 0.0
                for s in range(3):
                    design, target = weighted_system(bank, y[0], s)
                    penalty = float(bank.penalties[m, s, k])
                    covariance = np.eye(PIXELS) + design * bank.variances[m].numpy() @ design.T / penalty
                    a, _, _ = oracle(bank, y[0], m, k, s)
                    deviation = target - a * design @ bank.means[m].numpy()
                    energy = float((y[0, s] / bank.space.scale[s]).square().sum())
                    quadratic = deviation @ np.linalg.solve(covariance, deviation) + NOISE_FLOOR**2 * energy
                    expected -= 0.5 * np.linalg.slogdet(covariance)[1] + 0.5 * bank.independent_pixels * log(quadratic)
                assert float(found.log_evidence[0, m, k]) == pytest.approx(expected, rel=1e-5, abs=1e-4)

    @pytest.mark.parametrize(
        ("pixels", "photographs", "expected"),
        [(3080, 1, 385), (10, 1, 10 / (1 + 70 / 3080)), (6160, 2, 770), (6160, 1, 6160 / 15)],
    )
    def test_independent_pixels(self, pixels: int, photographs: int, expected: float):
        """Eight pixels count as one on a sphere of 64 x 64; fewer pixels lie farther apart."""
        space = ImageSpace.of(torch.rand(4, 3, pixels) + 0.1, [pixels // photographs] * photographs)
        assert PriorBank.of(space, torch.ones(1, 4).double()).independent_pixels == pytest.approx(expected)

    @pytest.mark.parametrize(
        ("pixels", "photographs", "expected"), [(3080, 1, 385 / 2), (3080, 2, 385 / 2), (1, 1, 1.0)]
    )
    def test_temperature(self, pixels: int, photographs: int, expected: float):
        """A photograph counts as two pixels, two photographs as four, a single pixel as itself."""
        space = ImageSpace.of(torch.rand(4, 3, pixels * photographs) + 0.1, [pixels] * photographs)
        assert PriorBank.of(space, torch.ones(1, 4).double()).temperature == pytest.approx(expected)

    def test_probabilities(self):
        """Softmax of the evidence over the temperature, by hand; parts of one distribution."""
        bank = bank_of(images(400))
        y = 0.3 + torch.rand(2, 3, 400, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
        found = bank.explain(y)
        assert bank.temperature > 10
        for b in range(2):
            tempered = np.exp((found.log_evidence[b] - found.log_evidence[b].max()).numpy() / bank.temperature)
            np.testing.assert_allclose(found.shares[b].numpy(), tempered / tempered.sum(), rtol=1e-9)
            np.testing.assert_allclose(found.of_priors[b].numpy(), tempered.sum(-1) / tempered.sum(), rtol=1e-9)
            within = tempered / tempered.sum(-1, keepdims=True)
            np.testing.assert_allclose(found.of_penalties[b].numpy(), within, rtol=1e-9)
            of_classes = found.log_evidence[b, :3].numpy()
            classes = np.exp(of_classes - of_classes.max()).sum(-1) ** (1 / bank.temperature)
            classes /= classes.sum()
            np.testing.assert_allclose(found.of_classes(3)[b].numpy(), classes, rtol=1e-9)

    def test_penalties_are_in_units_of_the_trace(self):
        bank = bank_of(images())
        assert float(PENALTIES[0]) == pytest.approx(10**-5.5)
        assert float(PENALTIES[-1]) == pytest.approx(10)
        m, s = 3, 1
        design, _ = weighted_system(bank, photographs(1)[0], s)
        trace = np.trace(design * bank.variances[m].numpy() @ design.T) / N
        np.testing.assert_allclose(bank.penalties[m, s].numpy(), PENALTIES.numpy() * trace, rtol=1e-6)

    def test_a_black_channel_of_the_photograph_says_nothing(self):
        bank, y = bank_of(images()), photographs(1)
        y[:, 1] = 0
        found = bank.explain(y)
        shares = found.shares
        assert torch.isfinite(found.log_evidence).all()
        assert float(found.components(shares)[:, :, 1].abs().max()) == 0
        red, blue = y.clone(), y.clone()
        red[:, 2], blue[:, 0] = 0, 0
        apart = bank.explain(red).log_evidence + bank.explain(blue).log_evidence
        assert torch.allclose(apart, found.log_evidence, rtol=1e-12)

    def test_masked_is_the_bank_of_the_masked_space(self):
        used = torch.rand(PIXELS, generator=torch.Generator().manual_seed(1)) < 0.6
        bank = bank_of(images())
        space = ImageSpace.weighted(images()[..., used], bank.space.scale[:, used])
        y = photographs()[..., used]
        found, expected = bank.masked(used).explain(y), PriorBank.of(space, bank.variances).explain(y)
        assert torch.allclose(found.log_evidence, expected.log_evidence, rtol=1e-6, atol=1e-5)
        shares = expected.shares
        weights = [one.components(shares).sum(1) for one in (found, expected)]
        assert torch.allclose(weights[0], weights[1], rtol=1e-4, atol=1e-5)

    @pytest.mark.parametrize("power", [-26, 3, 26])
    def test_scales_by_powers_of_two_change_no_bit(self, power: int):
        y, scale = photographs(), 2.0**power
        one, other = bank_of(images()).explain(y), bank_of(images() * scale).explain(y * scale)
        assert torch.equal(one.log_evidence, other.log_evidence)
        shares = one.shares
        assert torch.equal(one.components(shares), other.components(shares))

    def test_another_exposure_scales_the_weights(self):
        """A photograph twice as bright: twice the weights, and the same shares up to a constant of the evidence."""
        bank, y = bank_of(images()), photographs()
        one, other = bank.explain(y), bank.explain(4 * y)
        shares = [found.shares for found in (one, other)]
        assert torch.allclose(shares[0], shares[1], rtol=1e-9)
        weights = [found.components(shares[0]) for found in (one, other)]
        assert torch.allclose(4 * weights[0], weights[1], rtol=1e-12)

    def test_gradcheck(self):
        packed = images(14)
        bank = bank_of(packed)
        y = photographs(1)[..., :14].requires_grad_()

        def both(y: Tensor) -> tuple[Tensor, Tensor]:
            found = bank.explain(y)
            shares = found.shares
            return found.log_evidence[:, ::3, ::5], found.components(shares).sum(1)

        assert torch.autograd.gradcheck(both, y, atol=1e-4)

    def test_detached(self):
        found = bank_of(images()).explain(photographs().requires_grad_())
        assert found.log_evidence.requires_grad
        parts = found.detach()
        assert not any(
            x.requires_grad for x in (parts.brightness, parts.deviation, parts.quadratic, parts.log_evidence)
        )
        assert torch.equal(parts.log_evidence, found.log_evidence)


class TestComponents:
    def test_zero_outside_the_class(self):
        bank = bank_of(images())
        found = bank.explain(photographs())
        shares = found.of_penalties
        components = found.components(shares)
        for j in range(3):
            assert float(components[:, j, :, ~MEMBERSHIP[j]].abs().max()) == 0
            assert float(components[:, j, :, MEMBERSHIP[j]].abs().min()) > 0

    def test_linear_in_the_shares(self):
        found = bank_of(images()).explain(photographs())
        g = torch.Generator().manual_seed(0)
        a, b = (torch.rand(found.log_evidence.shape, generator=g, dtype=torch.float64) for _ in range(2))
        left, right = found.components(2 * a - b), 2 * found.components(a) - found.components(b)
        assert torch.allclose(left, right, rtol=0, atol=1e-6 * float(right.abs().max()))

    def test_a_photograph_of_a_batch_is_one_alone(self):
        bank, y = bank_of(images()), photographs(3)
        together = bank.explain(y)
        for b in range(3):
            alone = bank.explain(y[b : b + 1])
            shares = alone.shares
            assert torch.allclose(together.log_evidence[b], alone.log_evidence[0], rtol=1e-10)
            found = together.components(shares.expand_as(together.log_evidence))[b]
            assert torch.allclose(found, alone.components(shares)[0], rtol=1e-9, atol=1e-12)

    def test_precision_of_one_pair_and_of_the_average(self):
        """R^T R + lambda S^-1 of the only pair; for two, variances over penalties are averaged."""
        bank = bank_of(images())
        found = bank.explain(photographs())
        shares = torch.zeros_like(found.log_evidence)
        shares[0, 4, 7] = 1
        shares[1, 3, 2], shares[1, 2, 5] = 0.7, 0.3
        precision = found.precision(shares)
        for s in range(3):
            r = bank.space.r[s]
            one = bank.variances[4] / bank.penalties[4, s, 7]
            two = 0.7 * bank.variances[3] / bank.penalties[3, s, 2] + 0.3 * bank.variances[2] / bank.penalties[2, s, 5]
            for b, variance in enumerate((one, two)):
                assert torch.allclose(precision[b, s], r.T @ r + torch.diag(1 / variance), rtol=1e-12)

    def test_precision_is_finite_outside_a_class(self):
        bank = bank_of(images())
        found = bank.explain(photographs(1))
        shares = torch.zeros_like(found.log_evidence)
        shares[0, 1, 3] = 1
        diagonal = (found.precision(shares)[0] - bank.space.r.mT @ bank.space.r).diagonal(dim1=-2, dim2=-1)
        for s in range(3):
            outside = float(bank.penalties[1, s, 3]) * 1e6
            assert torch.allclose(diagonal[s, ~MEMBERSHIP[1]], torch.tensor(outside).double(), rtol=1e-6)


class TestPlantedTruth:
    @pytest.mark.parametrize("j", range(3))
    def test_the_class_of_a_photograph(self, j: int):
        """A mixture of one class's members with 0.5 % of noise: that class, among the classes, beyond doubt."""
        packed = images(400)
        bank = bank_of(packed)
        g = torch.Generator().manual_seed(j)
        weights = torch.zeros(3, N, dtype=torch.float64)
        members = torch.nonzero(MEMBERSHIP[j]).ravel()
        weights[:, members] = 1 / len(members) + 0.3 * torch.randn(3, len(members), generator=g, dtype=torch.float64)
        y = torch.einsum("nsp,sn->sp", packed.double(), weights)
        y = y * (1 + 0.005 * torch.randn(y.shape, generator=g, dtype=torch.float64))
        found = bank.explain(y[None])
        shares = found.shares
        assert float(shares.sum()) == pytest.approx(1)
        probabilities = torch.softmax(torch.logsumexp(found.log_evidence[0, :3], -1), -1)
        assert float(probabilities[j]) > 0.99
        average = found.components(shares).sum(1)[0]
        fitted = torch.einsum("nsp,sn->sp", packed.double(), average)
        assert float((fitted - y).norm() / y.norm()) < 0.01
        assert torch.allclose(average, weights, atol=0.1)

    def test_noise_raises_the_penalty(self):
        packed = images(400)
        bank = bank_of(packed)
        g = torch.Generator().manual_seed(5)
        weights = 1 / N + 0.2 * torch.randn(3, N, generator=g, dtype=torch.float64)
        clean = torch.einsum("nsp,sn->sp", packed.double(), weights)
        noise = torch.randn(clean.shape, generator=g, dtype=torch.float64)
        chosen = []
        for level in (0.0, 0.1, 1.0):
            evidence = bank.explain((clean * (1 + level * noise))[None]).log_evidence[0, 3]
            chosen.append(int(evidence.argmax()))
        assert chosen == sorted(chosen)
        assert chosen[0] < chosen[1] < chosen[2]


class TestPriors:
    def test_mean_one_and_in_order(self):
        space = ImageSpace.of(images(), [PIXELS])
        variances = prior_variances(MEMBERSHIP, NORMS, space)
        assert torch.allclose(variances.mean(1), torch.ones(len(variances), dtype=torch.float64), rtol=1e-12)
        for j in range(3):
            assert torch.allclose(variances[j], MEMBERSHIP[j].double() * N / MEMBERSHIP[j].sum(), rtol=1e-12)
        expected = NORMS ** (-2 * POWER)
        assert torch.allclose(variances[3], expected / expected.mean(), rtol=1e-12)
        assert 4 < len(variances) <= 4 + len(REACHES) * NEIGHBOURHOODS

    def test_neighbourhoods_fade_with_the_angle(self):
        space = ImageSpace.of(images(), [PIXELS])
        angles = image_angles(space)
        centres = farthest_points(angles, NEIGHBOURHOODS, 0.02)
        local = prior_variances(MEMBERSHIP, NORMS, space)[4:].unflatten(0, (len(REACHES), len(centres)))
        for reach, rows in zip(REACHES, local, strict=True):
            for row, centre in zip(rows, centres, strict=True):
                expected = torch.exp(-((angles[centre] / reach) ** 2)) * (NORMS / NORMS[centre]) ** (-2 * POWER)
                assert torch.allclose(row / row[centre], expected, rtol=1e-9)

    def test_norms_of_zero_and_of_any_unit(self):
        space = ImageSpace.of(images(), [PIXELS])
        reference = prior_variances(MEMBERSHIP, NORMS, space)
        assert torch.allclose(prior_variances(MEMBERSHIP, 1e7 * NORMS, space), reference, rtol=1e-9)
        norms = NORMS.clone()
        norms[3] = 0
        assert torch.isfinite(prior_variances(MEMBERSHIP, norms, space)).all()
        assert torch.isfinite(prior_variances(MEMBERSHIP, 0 * norms, space)).all()

    def test_means_add_up_to_one(self):
        bank = bank_of(images())
        assert torch.allclose(bank.means.sum(1), torch.ones(len(bank.means), dtype=torch.float64))
        expected = torch.where(MEMBERSHIP, 1 / MEMBERSHIP.sum(1, keepdim=True), 0).double()
        assert torch.allclose(bank.means[:3], expected, rtol=1e-6)
        deviation = NORMS**-POWER  # the mean goes with the root of S
        assert torch.allclose(bank.means[3], deviation / deviation.sum(), rtol=1e-9)

    def test_angles_by_hand(self):
        """Of two basis images, channel by channel, the mean of the three."""
        packed = images()
        space = ImageSpace.of(packed, [PIXELS])
        weighted = packed.double() / space.scale
        expected = 0.0
        for s in range(3):
            a, b = weighted[2, s], weighted[7, s]
            expected += acos(float(a @ b / (a.norm() * b.norm()))) / 3
        angles = image_angles(space)
        assert float(angles[2, 7]) == pytest.approx(expected, rel=1e-6)
        assert torch.allclose(angles, angles.T, atol=1e-7)
        assert float(angles.diagonal().abs().max()) < 1e-6


class TestFarthestPoints:
    LINE = torch.tensor([0.0, 1.0, 2.0, 4.0, 9.0])

    def distances(self) -> Tensor:
        return (self.LINE[:, None] - self.LINE).abs()

    def test_by_hand(self):
        """From the middle, 2, to 9, then 0, then 4 and 1: each the farthest from all before."""
        assert farthest_points(self.distances(), 5, 0.0) == [2, 4, 0, 3, 1]
        assert farthest_points(self.distances(), 3, 0.0) == [2, 4, 0]

    def test_none_nearer_than_asked(self):
        assert farthest_points(self.distances(), 5, 1.5) == [2, 4, 0, 3]
        assert farthest_points(self.distances(), 5, 2.0) == [2, 4]
        assert farthest_points(torch.zeros(4, 4), 3, 0.0) == [0]

    def test_points_without_a_distance_end_it(self):
        assert len(farthest_points(torch.full((4, 4), torch.nan), 3, 0.1)) == 1
