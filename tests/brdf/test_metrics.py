import math

import pytest
import torch

from torchbrdf.brdf.directions import half_difference
from torchbrdf.brdf.merl import GRID, N_CELLS, above_horizon, cell_index
from torchbrdf.brdf.metrics import CUBE_ROOT_OFFSET, METRICS, cell_measure, incident_cosine


def test_the_measure_is_that_of_two_hemispheres():
    measure, cosine = cell_measure(), incident_cosine()
    assert (measure.shape, measure.dtype) == (GRID, torch.float64)
    outgoing = cosine.flip(2)
    assert float(measure.sum()) == pytest.approx((2 * math.pi) ** 2, rel=3e-4)
    assert float((measure * cosine).sum()) == pytest.approx(math.pi * 2 * math.pi, rel=3e-4)
    assert float((measure * cosine * outgoing).sum()) == pytest.approx(math.pi**2, rel=3e-4)
    assert float((measure * cosine.square()).sum()) == pytest.approx(2 * math.pi / 3 * 2 * math.pi, rel=3e-4)


def test_the_measure_counts_directions():
    """Pairs drawn uniformly on both hemispheres fall into blocks of cells in proportion to the measure."""
    generator = torch.Generator().manual_seed(0)
    n = 400_000
    z, phi = torch.rand(2, 2, n, generator=generator, dtype=torch.float64)
    r, phi = torch.sqrt(1 - z * z), 2 * math.pi * phi
    w_i, w_o = torch.stack([r * torch.cos(phi), r * torch.sin(phi), z], -1)
    cells = cell_index(*half_difference(w_i, w_o)).long()
    counts = torch.bincount(cells, minlength=N_CELLS).reshape(GRID).double()

    def blocks(values):
        return values.reshape(6, 15, 6, 15, 6, 30).sum((1, 3, 5)).ravel()

    expected = blocks(cell_measure()) / (2 * math.pi) ** 2 * n
    found = blocks(counts)
    likely = expected > 200
    assert int(likely.sum()) > 100
    chi2 = ((found - expected).square() / expected)[likely].mean()
    assert 0.7 < float(chi2) < 1.6  # cells that the horizon cuts add to 1


def test_the_measure_is_zero_below_the_horizon_only():
    assert torch.equal(cell_measure() > 0, above_horizon())
    assert torch.equal(incident_cosine() > 0, above_horizon())


def test_values_by_hand():
    x = torch.tensor([0.0, 0.125, 7.0], dtype=torch.float64)
    assert METRICS["l2"](x).tolist() == [0.0, 0.125, 7.0]
    assert METRICS["log"](x).tolist() == pytest.approx([0.0, 0.11778303565638346, 2.0794415416798357])
    assert METRICS["cube-root"](x).tolist() == pytest.approx([0.0, 0.4978455787, 1.9107767481], rel=1e-7)
    assert list(METRICS) == ["l2", "log", "cube-root"]


@pytest.mark.parametrize("metric", METRICS)
def test_the_maps_can_be_differentiated_down_to_zero(metric):
    x = torch.tensor([1e-4, 0.03, 1.0, 200.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(METRICS[metric], (x,), eps=1e-8, atol=1e-5)
    zero = torch.zeros(1, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(METRICS[metric](zero).sum(), zero)
    assert float(slope) == pytest.approx(1 / 3 * CUBE_ROOT_OFFSET ** (-2 / 3) if metric == "cube-root" else 1.0)


def test_first_asked_for_in_inference_mode() -> None:
    """What is kept for all tables enters graphs later."""
    for make in (cell_measure, incident_cosine, above_horizon):
        make.cache_clear()
        with torch.inference_mode():
            make()
        assert not make().is_inference()
