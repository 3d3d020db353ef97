import re
import warnings

import pytest
import torch
from torch import Tensor

from columns import all_values, tiny_bounds
from program_oracles import another_order, relative, scipy_above, scipy_convex, scipy_nonnegative
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import above_horizon
from torchbrdf.estimation import constraints
from torchbrdf.estimation.constraints import CONSTRAINTS, TOLERANCE, Bounds, EnergyBounds, LobeBounds, constrain


@pytest.fixture(scope="module")
def bounds(tiny_library: MaterialLibrary) -> EnergyBounds:
    return tiny_bounds(tiny_library)


@pytest.fixture(scope="module")
def lobes(tiny_library: MaterialLibrary) -> LobeBounds:
    return LobeBounds.of(tiny_library)


@pytest.fixture(params=CONSTRAINTS)
def constrained(request: pytest.FixtureRequest, bounds: EnergyBounds, lobes: LobeBounds) -> tuple[str, Bounds]:
    """Every constraint, with bounds that it takes or does not look at."""
    return request.param, lobes if request.param == "lobes" else bounds


def posterior(
    library: MaterialLibrary,
    batch: tuple[int, ...] = (),
    seed: int = 0,
    brightness: float = 1.0,
    penalty: float = 1e-6,
    noisy: float = 0.1,
) -> tuple[Tensor, Tensor]:
    """Mean (*batch, 3, n) and precision (3, n, n) of noisy observations of 200 smooth functionals of the BRDF.

    Each observation averages some ten thousand cells, which makes the Gram matrix as ill-conditioned as that of basis
    images; condition about 1e8.
    """
    g = torch.Generator().manual_seed(seed)
    usable = torch.nonzero(above_horizon().ravel()).ravel()
    centre = usable[torch.randint(len(usable), (200,), generator=g)]
    n, seen = library.n, []
    for cell in centre.tolist():
        cells = cell // 16_200 * 16_200 + torch.randint(16_200, (30,), generator=g)
        cells = cells[above_horizon().ravel()[cells]]
        values = library.stored.columns[cells][:, library.column_index].double()
        seen.append((values * library.stored.scale[library.column_index]).sum(0))
    basis = torch.stack(seen)
    basis = basis / basis.abs().amax()
    basis = basis * torch.tensor([1.0, 0.9, 1.2], dtype=torch.float64)[:, None, None]
    truth = torch.rand(*batch, 3, n, generator=g, dtype=torch.float64) ** 6 * brightness
    image = torch.einsum("spc,...sc->...sp", basis, truth)
    noise = torch.randn(image.shape, generator=g, dtype=torch.float64)
    image = image + noisy * image.mean(-1, keepdim=True) * noise
    gram = basis.mT @ basis
    damping = penalty * gram.diagonal(dim1=-2, dim2=-1).mean(-1)
    precision = gram + damping[:, None, None] * torch.eye(n, dtype=torch.float64)
    projected = torch.einsum("spc,...sp->...sc", basis, image)
    return torch.linalg.solve(precision, projected[..., None])[..., 0], precision


@pytest.mark.parametrize("batch", [(), (2, 2)])
def test_each_photograph_and_channel_by_itself(
    tiny_library: MaterialLibrary, constrained: tuple[str, Bounds], batch: tuple[int, ...]
):
    """Shapes, feasibility, and the batch against single photographs with a precision of their own."""
    constraint, bounds = constrained
    mean, precision = posterior(tiny_library, batch)
    found = constrain(mean, precision, constraint, bounds)
    assert found.weights.shape == mean.shape
    assert found.optimality.shape == found.iterations.shape == mean.shape[:-1]
    assert found.optimality.max() < TOLERANCE
    assert not torch.equal(found.weights, mean)
    flat, expected = mean.reshape(-1, 3, 30), found.weights.reshape(-1, 3, 30)
    own = constrain(mean, precision.expand(*mean.shape, 30), constraint, bounds)
    assert relative(own.weights, found.weights) < 1e-4
    last = constrain(flat[-1], precision, constraint, bounds)
    if constraint in ("energy", "lobes"):
        assert relative(last.weights, expected[-1]) < 1e-4
    else:
        for w, single, point, h in zip(expected[-1], last.weights, flat[-1], precision, strict=True):
            assert float((single - w).norm()) <= another_order(point, h, w)
    if constraint == "convex":
        assert torch.allclose(found.weights.sum(-1), torch.ones(mean.shape[:-1], dtype=torch.float64))
    if isinstance(bounds, LobeBounds):
        falls, size = (w @ bounds.rows.mT for w in (expected, expected.abs()))
        assert (falls >= -TOLERANCE * size).all()
    elif constraint != "energy":
        assert (found.weights >= 0).all()


def test_simple_sets_agree_with_scipy(tiny_library: MaterialLibrary):
    mean, precision = posterior(tiny_library, (2,))
    positive, convex = (constrain(mean, precision, name).weights for name in ("nonnegative", "convex"))
    for b in range(2):
        for s in range(3):
            assert relative(positive[b, s], scipy_nonnegative(mean[b, s], precision[s])) < 1e-6
            assert relative(convex[b, s], scipy_convex(mean[b, s], precision[s])) < 1e-6


@pytest.mark.parametrize("brightness", [0.02, 8.0])
def test_energy_agrees_with_oracles(tiny_library: MaterialLibrary, bounds: EnergyBounds, brightness: float):
    """The oracle knows the albedo's rows and a few hundred cells only. Where its optimum is ours, which is feasible
    everywhere, ours is the optimum of the whole problem. Bright photographs meet the bound of the albedo."""
    mean, precision = posterior(tiny_library, brightness=brightness, noisy=0.5)
    found = constrain(mean, precision, "energy", bounds)
    weights = found.weights
    value, size = all_values(tiny_library, weights), all_values(tiny_library, weights.abs())
    touched = above_horizon().ravel()[:, None] & (value.abs() < 2e-6 * size)
    assert touched.any()
    for s in range(3):
        below = torch.unique(bounds.rows(torch.nonzero(touched[:, s]).ravel()), dim=0)
        assert len(below) < 2500
        rows = torch.cat([-bounds.albedo, below])
        limits = torch.zeros(len(rows), dtype=torch.float64)
        limits[: len(bounds.albedo)] = -1.0
        assert relative(weights[s], scipy_above(mean[s], precision[s], rows, limits)) < 1e-6
    highest = (weights @ bounds.albedo.mT).amax(-1)
    assert (highest <= 1 + 1e-9).all()
    assert (highest > 1 - 1e-9).any() == (brightness > 1)


def test_lobes_agree_with_scipy(tiny_library: MaterialLibrary, lobes: LobeBounds):
    mean, precision = posterior(tiny_library, noisy=0.5)
    found = constrain(mean, precision, "lobes", lobes).weights
    assert (lobes.rows @ mean.mT < 0).any(0).all()
    rows = lobes.rows[(lobes.rows != 0).any(-1)]
    for s in range(3):
        assert relative(found[s], scipy_above(mean[s], precision[s], rows, torch.zeros(len(rows)).double())) < 1e-6


def test_energy_on_six_materials_of_the_default_library(default_library: MaterialLibrary):
    """All cells of the table before it is clamped."""
    library = default_library.subset(default_library.names[5::20])
    bounds = EnergyBounds.of(library)
    mean, precision = posterior(library, seed=5)
    usable = above_horizon().ravel()

    def deepest(weights: Tensor) -> Tensor:
        value, size = all_values(library, weights), all_values(library, weights.abs())
        return (-value / size)[usable].amax(0)

    found = constrain(mean, precision, "energy", bounds)
    assert (deepest(mean) > 1e-2).all()
    assert (deepest(found.weights) < TOLERANCE).all()
    assert (found.optimality < TOLERANCE).all()
    assert (found.iterations > 0).all()
    clamped = library.combine(found.weights.T)
    raw = all_values(library, found.weights)[usable]
    assert torch.allclose(clamped.values.reshape(-1, 3)[usable].to(raw), raw, atol=1e-5 * float(raw.max()))


def test_feasible_means_come_back(tiny_library: MaterialLibrary, bounds: EnergyBounds):
    _, precision = posterior(tiny_library)
    positive = torch.rand(3, 30, generator=torch.Generator().manual_seed(0), dtype=torch.float64) / 30
    mixed = positive.clone()
    mixed[:, 3 * tiny_library.position("red")] -= 0.01  # white and teal keep the sum above zero
    mixed[:, 3 * tiny_library.position("white")] += 0.1
    cases = [(positive, "nonnegative"), (positive / positive.sum(-1, keepdim=True), "convex")]
    cases += [(positive, "energy"), (mixed, "energy"), (torch.zeros(3, 30).double(), "energy")]
    assert (mixed < 0).any()
    for mean, constraint in cases:
        found = constrain(mean, precision, constraint, bounds)
        assert torch.equal(found.weights, mean)
        assert (found.iterations == 0).all()
        assert (found.optimality < 1e-12).all()


def test_scale(tiny_library: MaterialLibrary):
    """Without the bound of the albedo "energy" has no scale, and "nonnegative" has none."""
    mean, precision = posterior(tiny_library)
    bounds = EnergyBounds.of(tiny_library, view_angles=0)
    for constraint in ("nonnegative", "energy"):
        expected = constrain(mean, precision, constraint, bounds).weights
        for exponent in (-26, 26):
            scaled = constrain(mean * 2.0**exponent, precision * 4.0**-exponent, constraint, bounds).weights
            assert torch.equal(scaled, expected * 2.0**exponent)


def test_a_class_of_some_columns(tiny_library: MaterialLibrary, bounds: EnergyBounds):
    members = torch.tensor([0, 5, 8, 11, 17, 22, 29])
    mean, precision = posterior(tiny_library)
    part = precision[:, members][:, :, members]
    found = constrain(mean[:, members], part, "energy", bounds.select(members))
    weights = torch.zeros_like(mean)
    weights[:, members] = found.weights
    value, size = all_values(tiny_library, weights), all_values(tiny_library, weights.abs())
    assert (value + TOLERANCE * size)[above_horizon().ravel()].amin() >= 0
    assert (found.iterations > 0).any()
    assert found.optimality.max() < TOLERANCE


def test_gradients(tiny_library: MaterialLibrary, constrained: tuple[str, Bounds]):
    """Along random directions of mean and precision, against differences."""
    constraint, bounds = constrained
    mean, precision = posterior(tiny_library, penalty=1e-3, brightness=0.1)
    g = torch.Generator().manual_seed(7)
    toward = torch.randn(3, 30, generator=g, dtype=torch.float64) * mean.abs()
    root = torch.randn(3, 30, 30, generator=g, dtype=torch.float64)
    twist = precision.diagonal(dim1=-2, dim2=-1).mean() * (root + root.mT)
    cost = torch.randn(3, 30, generator=g, dtype=torch.float64)

    def value(step: Tensor) -> Tensor:
        found = constrain(mean + step * toward, precision + step * 0.001 * twist, constraint, bounds)
        return (cost * found.weights).sum()

    step = torch.zeros((), dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(value(step), step)
    size = 1e-6
    difference = (value(torch.tensor(size).double()) - value(torch.tensor(-size).double())) / (2 * size)
    assert float(slope) == pytest.approx(float(difference), rel=2e-4)


def test_degenerate_input_stays_finite(tiny_library: MaterialLibrary, constrained: tuple[str, Bounds]):
    """A channel of zeros, one with every weight negative, duplicate columns; backward too."""
    constraint, bounds = constrained
    members = torch.tensor([0, 0, 3, 3, 3, 12, 20, 29])
    mean, precision = posterior(tiny_library)
    precision = precision[:, members][:, :, members]
    precision = precision + 1e-8 * precision.diagonal(dim1=-2, dim2=-1).amax() * torch.eye(8, dtype=torch.float64)
    mean = mean[:, members].clone()
    mean[0] = 0
    mean[1] = -mean[1].abs() - 0.1
    mean.requires_grad_()
    found = constrain(mean, precision, constraint, bounds.select(members))
    found.weights.square().sum().backward()
    assert torch.isfinite(found.weights).all()
    assert torch.isfinite(mean.grad).all()
    assert found.optimality.max() < TOLERANCE
    if constraint != "convex":
        assert torch.equal(found.weights[0], mean[0])


def test_single_precision_input(tiny_library: MaterialLibrary):
    mean, precision = posterior(tiny_library, penalty=1e-3)
    found = constrain(mean.float(), precision.float(), "nonnegative")
    assert found.weights.dtype == torch.float64
    assert relative(found.weights, constrain(mean, precision, "nonnegative").weights) < 1e-2


def test_a_wrong_answer_warns(tiny_library: MaterialLibrary, monkeypatch: pytest.MonkeyPatch):
    mean, precision = posterior(tiny_library)
    monkeypatch.setattr(
        constraints, "project_nonnegative", lambda m, *_: (m.clamp_min(0), torch.ones(len(m), dtype=torch.int64))
    )
    with pytest.warns(RuntimeWarning, match="'nonnegative' is not met exactly in 3 of 3 photographs and channels"):
        found = constrain(mean, precision, "nonnegative")
    assert (found.optimality > 1e-4).all()


def test_cells_left_below_zero_warn(
    tiny_library: MaterialLibrary, bounds: EnergyBounds, monkeypatch: pytest.MonkeyPatch
):
    mean, precision = posterior(tiny_library)
    none = torch.empty(0, dtype=torch.int64)
    monkeypatch.setattr(EnergyBounds, "scan", lambda _, w, __: (torch.full((len(w),), 3e-3).double(), none))
    with pytest.warns(RuntimeWarning, match=r"optimality residual up to 3\.0e-03, expected at most 1e-06"):
        found = constrain(mean, precision, "energy", bounds)
    assert torch.allclose(found.optimality, torch.full((3,), 3e-3).double())


def test_an_optimum_at_zero(tiny_library: MaterialLibrary, bounds: EnergyBounds):
    """Weights that would be rounding are 0: their sign would be noise."""
    mean, precision = posterior(tiny_library)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = constrain(-mean.abs(), precision, "energy", bounds)
    assert (found.weights == 0).all()
    assert (found.iterations > 0).all()


def test_no_warning_otherwise(tiny_library: MaterialLibrary, constrained: tuple[str, Bounds]):
    mean, precision = posterior(tiny_library)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        constrain(mean, precision, *constrained)


def test_bad_input(tiny_library: MaterialLibrary, bounds: EnergyBounds):
    mean, precision = posterior(tiny_library)
    broken, singular = mean.clone(), precision.clone()
    broken[0, 0], singular[1] = torch.nan, -precision[1]
    indefinite = precision.clone()
    indefinite[2, 0, 1] = indefinite[2, 1, 0] = 10 * precision[2].amax()
    cases = [
        ((mean, precision, "positive"), "constraint must be one of nonnegative, convex, energy, lobes, got 'positive'"),
        ((mean[:2], precision, "convex"), "mean must be (*batch, 3, c), got (2, 30)"),
        (
            (mean, precision[:, :9], "convex"),
            "precision must be (3, 30, 30) or (3, 30, 30) for this mean, got (3, 9, 30)",
        ),
        ((broken, precision, "convex"), "mean and precision must be finite"),
        ((mean, singular, "convex"), "precision must be positive definite, its diagonal is not"),
        ((mean, indefinite, "energy", bounds), "precision must be positive definite for rows of bounds"),
        ((mean, precision, "energy"), "pass EnergyBounds.of(library)"),
        ((mean, precision, "lobes", bounds), 'constraint "lobes" needs bounds; pass LobeBounds.of(library)'),
        ((mean, precision, "energy", bounds.select(torch.arange(5))), "bounds are for 5 weights, mean has 30"),
    ]
    for arguments, message in cases:
        with pytest.raises(ValueError, match=re.escape(message)):
            constrain(*arguments)
