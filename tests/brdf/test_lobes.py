import subprocess
import sys
from math import pi

import numpy as np
import pytest
import torch
from torch import Tensor

import lobe_fitting as fitting
from paths import ROOT
from torchbrdf.brdf.directions import from_half_difference, half_difference
from torchbrdf.brdf.lobes import PARAMETER_NAMES, evaluate_lobes, expand_row, load_default_parameters
from torchbrdf.brdf.merl import GRID, MerlTable, above_horizon, cell_centres
from torchbrdf.brdf.merl_directory import MERL_MATERIALS

NEUTRAL = {
    "strength": 1.0,
    "width": 0.1,
    "bend": 1.0,
    "decay": 1.0,
    "widening": 0.0,
    "widening_quadratic": 0.0,
    "grazing": 1.0,
    "exponent": 5.0,
    "slope": 0.0,
    "masking": 0.0,
    "softness": 0.1,
}
"""One lobe without Fresnel effect or shadowing: 1 / (1 + x / 0.1)."""


def one_lobe(**changes: float) -> dict[str, Tensor]:
    return {name: torch.tensor([[value]], dtype=torch.float64) for name, value in {**NEUTRAL, **changes}.items()}


def some_angles(count: int, seed: int = 0, lowest: float = 0.02) -> tuple[Tensor, Tensor, Tensor]:
    """Of direction pairs uniform over what lies at least `lowest` above the horizon in cosine."""
    generator = torch.Generator().manual_seed(seed)
    z = lowest + (1 - lowest) * torch.rand(2, count, generator=generator, dtype=torch.float64)
    phi = 2 * pi * torch.rand(2, count, generator=generator, dtype=torch.float64)
    sine = torch.sqrt(1 - z**2)
    w_i, w_o = torch.stack([sine * torch.cos(phi), sine * torch.sin(phi), z], dim=-1)
    return half_difference(w_i, w_o)


def some_parameters(n: int, lobes: int, seed: int = 0) -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    spread = {name: torch.randn(n, lobes, generator=generator, dtype=torch.float64) for name in PARAMETER_NAMES}
    signed = ("widening", "widening_quadratic", "slope", "masking")
    return {
        name: 0.5 * value if name in signed else NEUTRAL[name] * value.mul(0.5).exp() for name, value in spread.items()
    }


def test_a_lobe_without_decay_is_lambertian():
    f_r = evaluate_lobes(one_lobe(decay=0.0, strength=0.3 / pi), *some_angles(50))
    torch.testing.assert_close(f_r, torch.full_like(f_r, 0.3 / pi))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, 1 / (1 + 0.5 / 0.1)),
        ({"strength": 7.0}, 7 / (1 + 0.5 / 0.1)),
        ({"width": 0.25}, 1 / (1 + 0.5 / 0.25)),
        ({"decay": 2.0}, (1 + 0.5 / 0.1) ** -2),
        ({"bend": 2.0}, 1 / (1 + (0.5 / 0.1) ** 2)),
        ({"widening": 3.0}, 1 / (1 + 0.5 / (0.1 * np.exp(3 * 0.2)))),
        ({"widening_quadratic": 3.0}, 1 / (1 + 0.5 / (0.1 * np.exp(3 * 0.04)))),
        ({"grazing": 25.0}, (1 + 24 * 0.2**5) / (1 + 0.5 / 0.1)),
        ({"grazing": 25.0, "exponent": 2.0}, (1 + 24 * 0.2**2) / (1 + 0.5 / 0.1)),
        ({"slope": -2.0}, np.exp(-2 * 0.2) / (1 + 0.5 / 0.1)),
        ({"masking": 1.0}, 1 / (1 + 0.5 / 0.1) / 0.5**2),
        ({"masking": -1.0, "softness": 0.2}, 1 / (1 + 0.5 / 0.1) * 0.6**2),
    ],
)
def test_each_parameter_does_what_the_formula_says(changes, expected):
    """At cos theta_h = 0.5, cos theta_d = 0.8, phi_d = 90 degrees, where both cosines are 0.4."""
    theta_h, theta_d, phi_d = (torch.acos(torch.tensor(c, dtype=torch.float64)) for c in (0.5, 0.8, 0.0))
    f_r = evaluate_lobes(one_lobe(**changes), theta_h, theta_d, phi_d)
    assert f_r.shape == (1,)
    assert f_r.item() == pytest.approx(expected, rel=1e-9)


def test_lobes_add_up_and_angles_broadcast():
    parameters = some_parameters(4, 3)
    theta_h, theta_d, phi_d = (x.double() for x in cell_centres())
    both = evaluate_lobes(parameters, theta_h[::9], theta_d[::9], phi_d[::9])
    single = [{name: value[:, i : i + 1] for name, value in parameters.items()} for i in range(3)]
    assert both.shape == (10, 10, 20, 4)
    total = sum(evaluate_lobes(p, theta_h[::9], theta_d[::9], phi_d[::9]) for p in single)
    torch.testing.assert_close(both, total)


def test_reciprocal():
    w_i, w_o = from_half_difference(*some_angles(500))
    there = evaluate_lobes(some_parameters(5, 3), *half_difference(w_i, w_o))
    back = evaluate_lobes(some_parameters(5, 3), *half_difference(w_o, w_i))
    torch.testing.assert_close(there, back)
    lopsided = (w_i[:, 2] - w_o[:, 2]).abs() > 0.1
    assert lopsided.sum() > 100


def test_cosines_are_those_of_the_directions():
    """With g = -1 and a = 0, G is cos theta_i cos theta_o."""
    angles = some_angles(200)
    w_i, w_o = from_half_difference(*angles)
    f_r = evaluate_lobes(one_lobe(decay=0.0, masking=-1.0, softness=1e-12), *angles)[:, 0]
    torch.testing.assert_close(f_r, w_i[:, 2] * w_o[:, 2])


def test_gradients():
    angles = some_angles(6)
    values = [value.requires_grad_() for value in some_parameters(2, 2).values()]
    assert torch.autograd.gradcheck(
        lambda *p: evaluate_lobes(dict(zip(PARAMETER_NAMES, p, strict=True)), *angles), values
    )


@pytest.mark.parametrize("i", [0, 1, 40, 89])
def test_expanded_row_is_the_function_at_the_cell_centres(i):
    parameters = some_parameters(7, 3)
    theta_h, theta_d, phi_d = cell_centres()
    row = expand_row(parameters, theta_h[i].item())
    assert row.shape == (GRID[1] * GRID[2], 7)
    assert torch.isfinite(row).all()
    visible = above_horizon()[i].reshape(-1)
    expected = evaluate_lobes(parameters, theta_h[i], theta_d, phi_d).flatten(0, 1)
    torch.testing.assert_close(row[visible].double(), expected[visible], rtol=2e-4, atol=0.0)
    assert (expected[visible].amax(0) > 1.01 * expected[visible].amin(0)).all()


def test_missing_or_misshapen_parameters():
    parameters = one_lobe()
    with pytest.raises(ValueError, match=r"^lobe parameters lack bend, slope; each of PARAMETER_NAMES is needed$"):
        evaluate_lobes({k: v for k, v in parameters.items() if k not in ("bend", "slope")}, *some_angles(1))
    wrong = {**parameters, "slope": torch.zeros(1, 2)}
    with pytest.raises(ValueError, match=r"share one shape, got slope \(1, 2\) beside strength \(1, 1\)$"):
        expand_row(wrong, 0.1)
    with pytest.raises(ValueError, match=r"must be \(n, lobes\), got strength \(1,\)$"):
        expand_row({k: v[0] for k, v in parameters.items()}, 0.1)


def test_fitted_derivatives_are_those_of_the_model():
    """The Jacobian that scripts/lobe_fitting.py writes out, against autograd through evaluate_lobes."""
    generator = torch.Generator().manual_seed(3)
    p = torch.randn(3, 2, len(PARAMETER_NAMES), generator=generator) * 0.5
    cells = torch.nonzero(above_horizon().reshape(-1)).ravel()[::60_000]
    f_r, jacobian = fitting.model(p, fitting.Geometry.of_cells(cells), jacobian=True)

    def reference(p: Tensor) -> Tensor:
        return evaluate_lobes(fitting.to_parameters(p), *fitting.cell_angles(cells)).T

    torch.testing.assert_close(f_r.double(), reference(p.double()), rtol=1e-4, atol=0.0)
    full = torch.autograd.functional.jacobian(reference, p.double())  # (n, S, n, lobes, parameters)
    expected = torch.stack([full[i, :, i].flatten(1).T for i in range(3)])
    scale = expected.abs().amax(-1, keepdim=True)
    torch.testing.assert_close(jacobian.double() / scale, expected / scale, rtol=0.0, atol=1e-4)


def test_default_library_is_complete_and_small():
    names, parameters = load_default_parameters()
    assert len(names) == 100
    assert set(names) == set(MERL_MATERIALS)
    assert set(parameters) == set(PARAMETER_NAMES)
    assert all(len(value) == 3 * len(names) for value in parameters.values())
    assert all(torch.isfinite(value).all() for value in parameters.values())
    assert (ROOT / "torchbrdf" / "brdf" / "default_library.safetensors").stat().st_size <= 300_000


def test_default_library_is_finite_and_positive_above_the_horizon():
    _, parameters = load_default_parameters()
    for i in (0, 5, 30, 60, 85, 89):
        row = expand_row(parameters, cell_centres()[0][i].item())
        assert torch.isfinite(row).all()
        assert (row[above_horizon()[i].reshape(-1)] > 0).all()


def test_default_library_reflects_at_most_the_light_it_receives():
    """Albedo at normal incidence, where theta_h = theta_d = theta_i / 2."""
    _, parameters = load_default_parameters()
    t = (torch.arange(4000, dtype=torch.float64) + 0.5) / 4000
    theta_i = t**2 * pi / 2
    weight = 2 * pi * torch.sin(theta_i) * torch.cos(theta_i) * pi * t / 4000
    assert weight.sum().item() == pytest.approx(pi, rel=1e-6)
    f_r = evaluate_lobes(parameters, theta_i / 2, theta_i / 2, torch.zeros_like(theta_i))
    assert ((weight @ f_r.double()) < 1.0).all()


HARD = ["brass", "chrome", "blue-acrylic", "grease-covered-steel", "nylon", "pink-felt"]


@pytest.fixture(scope="module")
def decoded_tables(tmp_path_factory):
    tool = ROOT.parent / "shared" / "tools" / "decode_merl_neural.py"
    if not tool.exists():
        pytest.skip("../shared is absent: no encodings to decode tables from")
    folder = tmp_path_factory.mktemp("merl")
    subprocess.run([sys.executable, tool, folder, "--materials", *HARD], check=True, capture_output=True)
    return folder


@pytest.mark.parametrize("name", HARD)
def test_default_library_is_close_to_the_decoded_tables(name, decoded_tables):
    """The bounds on the worst material, on directions uniform on both hemispheres and on uniform cells."""
    names, parameters = load_default_parameters()
    first = 3 * names.index(name)
    own = {key: value[first : first + 3] for key, value in parameters.items()}
    rows = [expand_row(own, theta_h) for theta_h in cell_centres()[0].ravel().tolist()]
    fitted = MerlTable(torch.stack(rows).reshape(*GRID, 3), above_horizon())
    decoded = MerlTable.open(decoded_tables / f"{name}.binary")

    w_i, w_o = from_half_difference(*some_angles(20_000, seed=11, lowest=0.0))
    f, g = fitted.lookup(w_i, w_o), decoded.lookup(w_i, w_o)
    assert (torch.log1p(f * w_i[:, 2:]) - torch.log1p(g * w_i[:, 2:])).abs().mean() <= 0.02

    z_i, z_o = (w[..., 2] for w in from_half_difference(*cell_centres()))
    high = (z_i >= 0.05) & (z_o >= 0.05)
    cosine = z_i[high][:, None]
    error = (torch.log1p(fitted.values[high] * cosine) - torch.log1p(decoded.values[high] * cosine)).abs().mean()
    assert error <= 0.2
