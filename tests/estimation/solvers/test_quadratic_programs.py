from collections.abc import Iterator

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st
from torch import Tensor

from program_oracles import another_order, relative, scipy_above, scipy_convex, scipy_nonnegative
from torchbrdf.estimation.solvers.quadratic_programs import kkt_residual, project_above, project_nonnegative
from torchbrdf.threads import one_thread


@pytest.fixture(autouse=True)
def small_products() -> Iterator[None]:
    """Thousands of small products: after Mitsuba's threads have started, waking torch's for each takes minutes."""
    with one_thread():
        yield


def smooth_problem(c: int, n: int, decade: float, seed: int = 0, groups: int = 3) -> tuple[Tensor, Tensor, Tensor]:
    """Means (n, c), precisions (groups, c, c) of condition near 10^decade, and the groups.

    Columns are lobes of many widths on a small floor, as blurred as basis images of glossy materials: neighbours are
    nearly equal, and sizes differ.
    """
    g = torch.Generator().manual_seed(seed)
    position = torch.linspace(0, 1, 4 * c, dtype=torch.float64)
    centre = torch.rand(groups, c, 1, generator=g, dtype=torch.float64)
    width = 0.05 + 0.3 * torch.rand(groups, c, 1, generator=g, dtype=torch.float64)
    size = torch.exp(1.5 * torch.randn(groups, c, 1, generator=g, dtype=torch.float64))
    basis = size * (torch.exp(-(((position - centre) / width) ** 2)) + 0.05)
    gram = basis @ basis.mT
    largest = torch.linalg.eigvalsh(gram)[:, -1]
    precision = gram + (largest * 10**-decade)[:, None, None] * torch.eye(c, dtype=torch.float64)
    group = torch.arange(n) % groups
    truth = torch.rand(n, c, generator=g, dtype=torch.float64) ** 4
    truth = truth * (1 + torch.randn(n, c, generator=g, dtype=torch.float64))
    image = (truth[:, None] @ basis[group])[:, 0]
    noise = torch.randn(image.shape, generator=g, dtype=torch.float64)
    image = image + 0.1 * image.abs().mean(-1, keepdim=True) * noise
    mean = torch.linalg.solve(precision[group], (basis[group] @ image[..., None]))[..., 0]
    return mean, precision, group


def proxqp(
    mean: Tensor, precision: Tensor, rows: Tensor | None = None, bounds: Tensor | None = None, total: bool = False
) -> Tensor:
    """The same by ProxQP, in variables of unit diagonal and units of the mean."""
    proxsuite = pytest.importorskip("proxsuite", reason="proxsuite is not installed")
    c = len(mean)
    unit = precision.diagonal().rsqrt()
    size = float((mean / unit).abs().max())
    h = (precision * unit[:, None] * unit).numpy()
    a = torch.diag(unit) if rows is None else rows * unit
    b = torch.zeros(c, dtype=torch.float64) if bounds is None else bounds / size
    length = torch.linalg.vector_norm(a, dim=1)
    equality = ((unit * size)[None].numpy(), np.ones(1)) if total else (None, None)
    result = proxsuite.proxqp.dense.solve(
        H=h,
        g=-h @ (mean / unit / size).numpy(),
        A=equality[0],
        b=equality[1],
        C=(a / length[:, None]).numpy(),
        l=(b / length).numpy(),
        u=None,
        eps_abs=1e-13,
        eps_rel=0.0,
        max_iter=100000,
    )
    return torch.from_numpy(result.x) * unit * size


@pytest.mark.parametrize("decade", [2.0, 5.0, 8.0])
class TestOracles:
    def test_nonnegative_by_scipy(self, decade: float):
        mean, precision, group = smooth_problem(60, 6, decade)
        weights, _ = project_nonnegative(mean, precision, group)
        for n in range(6):
            assert relative(weights[n], scipy_nonnegative(mean[n], precision[group[n]])) < 1e-6
        assert ((weights > 0).sum(-1) > 1).all()
        assert (weights == 0).any()

    def test_convex_by_scipy(self, decade: float):
        mean, precision, group = smooth_problem(60, 6, decade)
        weights, _ = project_nonnegative(mean, precision, group, sum_to_one=True)
        for n in range(6):
            assert relative(weights[n], scipy_convex(mean[n], precision[group[n]])) < 1e-6

    def test_rows_by_scipy(self, decade: float):
        mean, precision, group = smooth_problem(40, 6, decade)
        rows, bounds = smooth_rows(40, 150)
        weights, multipliers, _ = project_above(mean, torch.linalg.cholesky(precision), group, rows, bounds)
        for n in range(6):
            assert relative(weights[n], scipy_above(mean[n], precision[group[n]], rows, bounds)) < 1e-6
        assert (multipliers > 0).any(-1).sum() > 3

    def test_all_by_proxsuite(self, decade: float):
        mean, precision, group = smooth_problem(25, 3, decade)
        rows, bounds = smooth_rows(25, 60)
        found = [
            project_nonnegative(mean, precision, group)[0],
            project_nonnegative(mean, precision, group, sum_to_one=True)[0],
            project_above(mean, torch.linalg.cholesky(precision), group, rows, bounds)[0],
        ]
        for n in range(3):
            h = precision[group[n]]
            assert relative(found[0][n], proxqp(mean[n], h)) < 1e-6
            assert relative(found[1][n], proxqp(mean[n], h, total=True)) < 1e-6
            assert relative(found[2][n], proxqp(mean[n], h, rows, bounds)) < 1e-6


def smooth_rows(c: int, m: int) -> tuple[Tensor, Tensor]:
    """Rows (m, c) that resemble their neighbours, as cells of a BRDF do, and bounds; w = 0 fulfils the last third."""
    g = torch.Generator().manual_seed(9)
    x = torch.linspace(0, 1, m, dtype=torch.float64)[:, None]
    centre = torch.rand(c, generator=g, dtype=torch.float64)
    rows = 10 * torch.exp(-(((x - centre) / 0.04) ** 2)) + 0.1 * torch.rand(c, generator=g, dtype=torch.float64)
    bounds = torch.full((m,), 0.3, dtype=torch.float64)
    rows[2 * m // 3 :], bounds[2 * m // 3 :] = -rows[2 * m // 3 :] / 50, -1.0
    return rows, bounds


@given(st.integers(0, 10**6), st.integers(1, 12), st.floats(0, 10), st.booleans())
def test_conditions_of_optimality(seed: int, c: int, decade: float, sum_to_one: bool):
    """Duplicate columns included: every third column twice."""
    mean, precision, group = smooth_problem(c, 4, decade, seed)
    twins = torch.arange(c) - (torch.arange(c) % 3 == 2).long()
    spread = torch.eye(c, dtype=torch.float64)[twins]
    ridge = 1e-9 * precision.diagonal(dim1=-2, dim2=-1).amax(-1)[:, None, None] * torch.eye(c, dtype=torch.float64)
    precision = spread @ precision @ spread.mT + ridge
    weights, _ = project_nonnegative(mean, precision, group, sum_to_one)
    assert torch.isfinite(weights).all()
    assert (weights >= 0).all()
    if sum_to_one:
        assert torch.allclose(weights.sum(-1), torch.ones(4, dtype=torch.float64), atol=1e-12)
    assert (kkt_residual(mean, precision, group, weights, sum_to_one=sum_to_one) < 1e-9).all()


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(-26, 26), st.floats(0, 9))
def test_powers_of_two_scale_exactly(seed: int, exponent: int, decade: float):
    mean, precision, group = smooth_problem(9, 3, decade, seed)
    rows, _ = smooth_rows(9, 30)
    rows, bounds, factor = rows[:20], torch.zeros(20, dtype=torch.float64), torch.linalg.cholesky(precision)
    scaled = mean * 2.0**exponent
    one, other = (project_nonnegative(m, precision, group)[0] for m in (mean, scaled))
    assert torch.equal(one * 2.0**exponent, other)
    one, other = (project_above(m, factor, group, rows, bounds)[0] for m in (mean, scaled))
    assert torch.equal(one * 2.0**exponent, other)
    one, other = (project_nonnegative(mean, h, group)[0] for h in (precision, precision * 4.0**exponent))
    assert torch.equal(one, other)


@given(st.integers(0, 10**6), st.integers(1, 10))
def test_no_feasible_step_lowers_the_distance(seed: int, c: int):
    mean, precision, group = smooth_problem(c, 3, 4.0, seed)
    weights, _ = project_nonnegative(mean, precision, group)
    g = torch.Generator().manual_seed(seed)

    def distance(w: Tensor) -> Tensor:
        return ((w - mean)[:, None] @ precision[group] @ (w - mean)[..., None])[:, 0, 0]

    for size in (1e-3, 1.0):
        step = size * weights.abs().max() * torch.randn(3, c, generator=g, dtype=torch.float64)
        moved = (weights + step).clamp_min(0)
        assert (distance(moved) >= distance(weights) * (1 - 1e-9)).all()


@pytest.mark.parametrize("sum_to_one", [False, True])
def test_residual_is_large_for_wrong_answers(sum_to_one: bool):
    mean, precision, group = smooth_problem(30, 3, 5.0)
    right, _ = project_nonnegative(mean, precision, group, sum_to_one)

    def residual(w: Tensor) -> Tensor:
        return kkt_residual(mean, precision, group, w, sum_to_one=sum_to_one)

    assert residual(right).max() < 1e-10
    clipped = mean.clamp_min(0)
    wrong = {
        "clipped": clipped / clipped.sum(-1, keepdim=True) if sum_to_one else clipped,
        "infeasible": mean,
        "brighter": 1.001 * right,
        "one dropped": right * (right < right.amax(-1, keepdim=True)),
    }
    for name, weights in wrong.items():
        assert (residual(weights) > 1e-5).all(), name


def test_residual_of_rows_sees_each_condition():
    mean, precision, group = smooth_problem(12, 3, 4.0)
    rows, bounds = smooth_rows(12, 40)
    factor = torch.linalg.cholesky(precision)
    weights, multipliers, _ = project_above(mean, factor, group, rows, bounds)

    def residual(w: Tensor, m: Tensor) -> Tensor:
        return kkt_residual(mean, precision, group, w, m, rows, bounds)

    assert residual(weights, multipliers).max() < 1e-9
    assert (residual(mean, torch.zeros_like(multipliers)) > 1e-3).all()  # primal only
    assert (residual(weights, 1.1 * multipliers) > 1e-6).all()  # stationarity
    inside = weights * 0.5
    pull = (precision[group] @ (inside - mean)[..., None])[..., 0]
    fitted = pull @ torch.linalg.pinv(rows)
    assert (residual(inside, fitted) > 1e-5).all()  # dual and complementarity


@pytest.mark.parametrize("sum_to_one", [False, True])
def test_gradients_of_nonnegative(sum_to_one: bool):
    mean, precision, group = smooth_problem(4, 2, 3.0, seed=2, groups=2)
    root = torch.linalg.cholesky(precision).requires_grad_()
    mean = (mean / mean.abs().amax(-1, keepdim=True)).requires_grad_()

    def weights(m: Tensor, r: Tensor) -> Tensor:
        return project_nonnegative(m, r @ r.mT, group, sum_to_one)[0]

    assert ((weights(mean, root) > 0).sum(-1) > 1).any()
    assert torch.autograd.gradcheck(weights, (mean, root), eps=1e-7, atol=1e-5, rtol=1e-4)


def test_gradients_of_rows():
    mean, precision, group = smooth_problem(5, 2, 3.0, seed=1, groups=2)
    rows, bounds = smooth_rows(5, 24)
    lower = bounds - 0.05
    root = torch.linalg.cholesky(precision).requires_grad_()
    mean = (mean / mean.abs().amax(-1, keepdim=True)).requires_grad_()

    def weights(m: Tensor, r: Tensor) -> Tensor:
        return project_above(m, torch.linalg.cholesky(r @ r.mT), group, rows, lower)[0]

    touching = (weights(mean, root) @ rows.mT - lower).abs() < 1e-9
    assert touching.any(-1).any()
    # weights of such rows are right to 1e-12, which a step of 1e-7 makes 1e-5 of a difference
    assert torch.autograd.gradcheck(weights, (mean, root), eps=1e-5, atol=1e-5, rtol=1e-4)


def test_batches_equal_loops_and_own_precisions_equal_shared_ones():
    mean, precision, group = smooth_problem(20, 9, 6.0)
    factor, (rows, bounds) = torch.linalg.cholesky(precision), smooth_rows(20, 60)
    for sum_to_one in (False, True):
        together, _ = project_nonnegative(mean, precision, group, sum_to_one)
        own, _ = project_nonnegative(mean, precision[group], torch.arange(9), sum_to_one)
        for n in range(9):
            alone, _ = project_nonnegative(mean[n : n + 1], precision, group[n : n + 1], sum_to_one)
            bound = another_order(mean[n], precision[group[n]], together[n])
            assert float((own[n] - together[n]).norm()) <= bound
            assert float((alone[0] - together[n]).norm()) <= bound
    together, _, _ = project_above(mean, factor, group, rows, bounds)
    own, _, _ = project_above(mean, factor[group], torch.arange(9), rows, bounds)
    assert relative(own, together) < 1e-9
    for n in range(9):
        alone, _, _ = project_above(mean[n : n + 1], factor, group[n : n + 1], rows, bounds)
        assert relative(together[n : n + 1], alone) < 1e-9


def test_a_feasible_mean_comes_back_as_it_is():
    _, precision, group = smooth_problem(20, 3, 8.0)
    mean = torch.rand(3, 20, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    mean[1, 4] = -0.3
    weights, iterations = project_nonnegative(mean, precision, group)
    assert torch.equal(weights[[0, 2]], mean[[0, 2]])
    assert iterations[[0, 2]].tolist() == [0, 0]
    assert iterations[1] > 0
    mean[1, 4] = 0.3
    assert project_nonnegative(mean, precision, group)[0] is mean
    shares = mean / mean.sum(-1, keepdim=True)
    assert project_nonnegative(shares, precision, group, sum_to_one=True)[0] is shares
    assert not torch.equal(project_nonnegative(mean, precision, group, sum_to_one=True)[0], mean)


def test_nothing_but_zero_is_left():
    """A precision without coupling: what is negative goes to 0 and nothing else moves; all negative gives all 0."""
    precision = torch.diag_embed(torch.tensor([[1.0, 4.0, 9.0]], dtype=torch.float64))
    mean = torch.tensor([[-1.0, -2.0, -3.0], [-1.0, 0.5, 2.0], [0.0, 0.0, 0.0]], dtype=torch.float64)
    weights, _ = project_nonnegative(mean, precision, torch.zeros(3, dtype=torch.int64))
    assert torch.equal(weights, mean.clamp_min(0))
    identity = torch.eye(3, dtype=torch.float64)[None]
    shares, _ = project_nonnegative(mean, identity, torch.zeros(3, dtype=torch.int64), sum_to_one=True)
    expected = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1 / 3] * 3], dtype=torch.float64)
    assert torch.allclose(shares, expected, atol=1e-12)


def test_one_weight():
    one, group = torch.full((1, 1, 1), 3.0, dtype=torch.float64), torch.zeros(2, dtype=torch.int64)
    mean = torch.tensor([[-2.0], [2.0]], dtype=torch.float64)
    assert project_nonnegative(mean, one, group)[0].tolist() == [[0.0], [2.0]]
    shares, _ = project_nonnegative(mean, one, group, sum_to_one=True)
    assert shares.ravel().tolist() == pytest.approx([1.0, 1.0], rel=1e-12)
    rows, bounds = torch.tensor([[2.0]], dtype=torch.float64), torch.tensor([1.0], dtype=torch.float64)
    weights, _, _ = project_above(mean, one.sqrt(), group, rows, bounds)
    assert weights.ravel().tolist() == pytest.approx([0.5, 2.0], rel=1e-12)


def test_rows_twice_and_rows_of_zeros():
    mean, precision, group = smooth_problem(10, 3, 6.0)
    rows, bounds = smooth_rows(10, 30)
    factor = torch.linalg.cholesky(precision)
    once, _, _ = project_above(mean, factor, group, rows, bounds)
    more = torch.cat([rows, rows, 3 * rows[:5], torch.zeros(2, 10, dtype=torch.float64)])
    limits = torch.cat([bounds, bounds, 3 * bounds[:5], torch.tensor([0.0, -1.0], dtype=torch.float64)])
    twice, multipliers, _ = project_above(mean, factor, group, more, limits)
    assert relative(twice, once) < 1e-7
    assert torch.isfinite(multipliers).all()


def test_without_rows_nothing_moves():
    mean, precision, group = smooth_problem(10, 3, 6.0)
    none = torch.empty(0, 10, dtype=torch.float64)
    weights, multipliers, _ = project_above(mean, torch.linalg.cholesky(precision), group, none, none[:, 0])
    assert torch.equal(weights, mean)
    assert multipliers.shape == (3, 0)


def test_a_warm_start_ends_in_the_same_place():
    mean, precision, group = smooth_problem(30, 3, 6.0)
    rows, bounds = smooth_rows(30, 90)
    factor = torch.linalg.cholesky(precision)
    cold, multipliers, slow = project_above(mean, factor, group, rows, bounds)
    warm, _, quick = project_above(mean, factor, group, rows, bounds, start=multipliers)
    assert relative(warm, cold) < 1e-9
    assert (quick < slow).all()


@pytest.mark.parametrize("sum_to_one", [False, True])
def test_three_hundred_columns(must_end, sum_to_one: bool):
    """As many as the whole library; condition 1e10, and a mean of which few weights are negative."""
    mean, precision, group = smooth_problem(300, 3, 10.0)
    for start in (mean, mean.abs() * torch.where(torch.arange(300) % 37 == 0, -1.0, 1.0)):
        weights, _ = project_nonnegative(start, precision, group, sum_to_one)
        assert kkt_residual(start, precision, group, weights, sum_to_one=sum_to_one).max() < 1e-8
