from itertools import chain, combinations

import pytest
import torch
from hypothesis import given, strategies as st
from torch import Tensor

from torchbrdf.estimation.solvers._active_set import Metric, active_set, grouped, power_of_two


def by_enumeration(matrix: Tensor, d: Tensor, total: Tensor | None) -> Tensor:
    """The best of the minima of all free sets that are feasible."""
    k = len(d)
    best, lowest = torch.zeros(k, dtype=torch.float64), torch.inf if total is not None else 0.0
    for chosen in chain.from_iterable(combinations(range(k), r) for r in range(1, k + 1)):
        free = torch.tensor(chosen)
        block, right = matrix[free][:, free], d[free]
        x = torch.zeros(k, dtype=torch.float64)
        x[free] = torch.linalg.solve(block, right)
        if total is not None:
            along = torch.linalg.solve(block, total[free])
            x[free] += (1 - total @ x) / (total[free] @ along) * along
        value = 0.5 * x @ matrix @ x - d @ x
        if (x >= 0).all() and value < lowest:
            best, lowest = x, value
    return best


def unit_metric(k: int, seed: int, groups: int = 1) -> Tensor:
    g = torch.Generator().manual_seed(seed)
    factor = torch.randn(groups, k + 1, k, generator=g, dtype=torch.float64)
    factor = factor / torch.linalg.vector_norm(factor, dim=-2, keepdim=True)
    return factor.mT @ factor


@given(st.integers(0, 10**6), st.integers(1, 6), st.booleans(), st.booleans())
def test_the_best_of_all_free_sets(seed: int, k: int, with_total: bool, from_corner: bool):
    matrix = unit_metric(k, seed, groups=2)
    g = torch.Generator().manual_seed(seed + 1)
    d = torch.randn(5, k, generator=g, dtype=torch.float64)
    group = torch.tensor([0, 1, 1, 0, 1])
    total = torch.rand(2, k, generator=g, dtype=torch.float64) + 0.5 if with_total else None
    start = torch.zeros_like(d)
    if with_total:
        start[:, 0] = 1 / total[group, 0]
    elif from_corner:
        start = torch.rand(5, k, generator=g, dtype=torch.float64)
    end = active_set(Metric(matrix, group, total), d, start)
    for n in range(5):
        expected = by_enumeration(matrix[group[n]], d[n], None if total is None else total[group[n]])
        assert torch.allclose(end.x[n], expected, rtol=1e-8, atol=1e-9)
        assert ((end.x[n] > 0) <= end.free[n]).all()


def test_more_rows_than_dimensions_end(must_end):
    """M of rank 3 for 200 variables: any free set of four is singular; the gradient still vanishes."""
    g = torch.Generator().manual_seed(1)
    rows = torch.nn.functional.normalize(torch.rand(1, 200, 3, generator=g, dtype=torch.float64), dim=-1)
    d = torch.rand(4, 200, generator=g, dtype=torch.float64) - 0.2
    metric = Metric(rows @ rows.mT, torch.zeros(4, dtype=torch.int64), ridge=1e-13)
    x = active_set(metric, d, torch.zeros_like(d)).x
    down = d - metric.times(x)
    assert (x >= 0).all()
    assert down.amax() < 1e-9
    assert (down * x).abs().amax() < 1e-9


def test_a_start_at_the_optimum_takes_one_solve():
    matrix = unit_metric(8, 3)
    d = torch.randn(2, 8, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    metric = Metric(matrix, torch.zeros(2, dtype=torch.int64))
    first = active_set(metric, d, torch.zeros_like(d))
    again = active_set(metric, d, first.x)
    assert again.iterations.tolist() == [1, 1]
    assert first.iterations.min() > 1
    assert torch.allclose(again.x, first.x, rtol=1e-12)


@pytest.mark.parametrize("groups", [1, 3, 8])
def test_grouped_products(groups: int):
    g = torch.Generator().manual_seed(0)
    matrix = torch.randn(groups, 4, 5, generator=g, dtype=torch.float64)
    x = torch.randn(8, 4, generator=g, dtype=torch.float64)
    group = torch.randint(groups, (8,), generator=g)
    expected = torch.stack([x[n] @ matrix[group[n]] for n in range(8)])
    assert torch.allclose(grouped(matrix, group, x), expected)


def test_powers_of_two():
    scale = torch.tensor([1.0, 3.1, 0.2, 0.0, float("inf")], dtype=torch.float64)
    assert power_of_two(scale).tolist() == [1.0, 4.0, 0.25, 1.0, 1.0]
