import pytest
import torch
from torch import Tensor

from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.brdf.merl_grid import above_horizon, cell_centres
from torchbrdf.estimation.classes import MaterialClasses
from torchbrdf.estimation.estimator import BRDFEstimator
from torchbrdf.estimation.lobe_bounds import LobeBounds
from torchbrdf.light.probe import LightProbe
from torchbrdf.rendering.basis import render_basis
from torchbrdf.transport.basis_images import BasisImages
from torchbrdf.view.sphere import SphereView


def fades(table: MerlTable) -> bool:
    """Whether all channels of a material meet the bounds of a library of it alone."""
    rows = LobeBounds.of(MaterialLibrary.from_tables([table])).rows
    return bool((rows >= 0).all())


def lobe(middle: float, width: float = 2.0) -> MerlTable:
    """A highlight over a floor, brightest so many degrees from the half vector's normal."""
    theta_h = torch.rad2deg(cell_centres()[0])
    f_r = 0.1 + 5 * torch.exp(-(((theta_h - middle) / width) ** 2))
    return MerlTable(f_r.expand(90, 90, 180)[..., None].expand(-1, -1, -1, 3).contiguous(), above_horizon())


def test_highlights_that_fall_off_are_inside():
    assert fades(lobe(0))


def test_rings_and_holes_are_not():
    assert not fades(lobe(1))
    assert not fades(lobe(3))


def test_rows_are_of_the_table_that_the_weights_give(tiny_library: MaterialLibrary):
    weights = torch.randn(tiny_library.n, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    table = tiny_library.combine(weights)
    d, last = 30, 18
    falls = table.values[0, d, 90] - table.values[1, d, 90]
    rows = LobeBounds.of(tiny_library).rows.unflatten(0, (6, 10))[2] @ weights
    seen = table.values[[0, 1, last], d, 90] > 0  # others were clamped
    assert torch.allclose(rows[0][seen[:2].all(0)].float(), falls[seen[:2].all(0)], rtol=1e-3, atol=1e-3)
    assert torch.allclose(rows[-1].clamp_min(0).float(), table.values[last, d, 90], rtol=1e-3, atol=1e-3)


def test_some_columns(tiny_library: MaterialLibrary):
    bounds, members = LobeBounds.of(tiny_library), torch.tensor([4, 0, 9])
    assert torch.equal(bounds.select(members).rows, bounds.rows[:, members])
    assert repr(bounds.select(members)) == "LobeBounds(3 columns, 60 rows)"


@pytest.fixture(scope="module")
def basis(tiny_library: MaterialLibrary) -> BasisImages:
    return render_basis(tiny_library, LightProbe.default(32), SphereView(16), samples=512)


@pytest.fixture(scope="module")
def classes(tiny_library: MaterialLibrary) -> MaterialClasses:
    return MaterialClasses.fit(tiny_library, n_classes=2, n_dims=2)


@pytest.fixture(scope="module")
def photographs(basis: BasisImages) -> Tensor:
    """One whose highlights no combination has without a hole, and one that a combination is."""
    matte, glossy = (basis.image(name).double() for name in ("white", "copper-0.08"))
    return torch.stack([(matte - 0.3 * glossy).clamp_min(1e-3), 0.5 * matte + 0.2 * glossy])


@pytest.mark.parametrize("penalty", ["auto", 0.01])
def test_holes_are_filled(basis, classes, photographs, tiny_library: MaterialLibrary, penalty):
    rows = LobeBounds.of(tiny_library).rows
    estimate = BRDFEstimator(basis, classes, penalty, constraint="lobes", library=tiny_library)
    result, free = estimate(photographs), BRDFEstimator(basis, classes, penalty)(photographs)
    assert (rows @ free.weights[0] < -1e-2).any()
    assert (rows @ result.weights >= -1e-9 * (rows.abs() @ result.weights.abs())).all()
    assert float(result.optimality.max()) < 1e-6
    assert float(result.error[0]) > float(free.error[0])
    assert torch.allclose(estimate(photographs[1]).weights, result.weights[1], rtol=1e-6, atol=1e-9)


def test_gradients_of_estimates(basis, classes, photographs, tiny_library: MaterialLibrary):
    """Of the posterior's metric, too: against a difference along a direction."""
    estimate = BRDFEstimator(basis, classes, constraint="lobes", library=tiny_library)
    cost = torch.linspace(-1, 1, 3 * tiny_library.n, dtype=torch.float64).view(-1, 3)
    toward = photographs[0] * torch.randn(photographs[0].shape, generator=torch.Generator().manual_seed(4)).double()

    def value(step: Tensor) -> Tensor:
        return (cost * estimate(photographs[0] + step * toward).weights).sum()

    step = torch.zeros((), dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(value(step), step)
    size = torch.tensor(1e-6).double()
    assert float(slope) == pytest.approx(float((value(size) - value(-size)) / (2 * size)), rel=1e-4)
