"""What holds for every analytic model."""

import re

import pytest
import torch
from hypothesis import given, strategies as st
from torch import Tensor

from bsdf_cases import albedo, direction_pairs, interior, some_geometry
from paths import ROOT
from torchbrdf.analytic import MODELS, AnalyticModel, model_of
from torchbrdf.analytic.shading_geometry import ShadingGeometry

ALL = sorted(MODELS)
CHEAP = [name for name in ALL if name != "rough-plastic"]


def ends_of(model: AnalyticModel, most: int = 12) -> list[dict[str, float]]:
    """Parameters at their bounds: all at one end, and combinations in which each pair of ends occurs."""
    count = len(model.parameters)
    patterns = [0, 2**count - 1, *((37 * k) % 2**count for k in range(1, most - 1))]
    return [
        {p.name: (p.upper if pattern >> i & 1 else p.lower) for i, p in enumerate(model.parameters)}
        for pattern in dict.fromkeys(patterns)
    ]


def awkward_geometry() -> ShadingGeometry:
    """Pairs at and below the horizon, at theta_h = 0 and pi/2, and some others."""
    edges = torch.tensor([0.0, 1e-9, 1e-4, 0.8, torch.pi / 2 - 1e-4, torch.pi / 2], dtype=torch.float64)
    swings = torch.tensor([0.0, torch.pi / 2, torch.pi], dtype=torch.float64)
    return ShadingGeometry.of_angles(*torch.cartesian_prod(edges, edges, swings).T)


@pytest.mark.parametrize("name", ALL)
def test_values_and_slopes_are_finite_at_all_bounds(name: str):
    model = MODELS[name]
    for dtype in (torch.float64, torch.float32):
        geometry = awkward_geometry().to(dtype)
        for ends in ends_of(model, 4 if name == "rough-plastic" else 12):
            values = {
                p.name: torch.full((3 if p.colour else 1,), ends[p.name], dtype=dtype, requires_grad=True)
                for p in model.parameters
            }
            f_r = model.evaluate(values, geometry)
            slopes = torch.autograd.grad(f_r.sum(), list(values.values()))
            assert f_r.isfinite().all(), ends
            assert all(slope.isfinite().all() for slope in slopes), ends
            assert (f_r >= 0).all(), ends


@pytest.mark.parametrize("name", ALL)
def test_shapes_and_what_lies_below_the_horizon(name: str):
    geometry = awkward_geometry()
    f_r = MODELS[name].evaluate(interior(name), geometry)
    assert f_r.shape == (len(geometry.above), 3)
    assert (f_r[~geometry.above[:, 0]] == 0).all()
    assert (f_r[geometry.above[:, 0]] >= 0).all()
    assert f_r.dtype == torch.float64


unit = st.floats(0.01, 1)
turn = st.floats(-torch.pi, torch.pi)


@given(unit, unit, turn, st.sampled_from(CHEAP))
def test_reciprocity(z_i: float, z_o: float, apart: float, name: str):
    w_i = torch.tensor([[(1 - z_i**2) ** 0.5, 0, z_i]], dtype=torch.float64)
    sine = (1 - z_o**2) ** 0.5
    angle = torch.tensor(apart, dtype=torch.float64)
    w_o = torch.stack([sine * angle.cos(), sine * angle.sin(), torch.tensor(z_o).double()])[None]
    model = MODELS[name]
    there = model.evaluate(interior(name), ShadingGeometry.of_directions(w_i, w_o))
    back = model.evaluate(interior(name), ShadingGeometry.of_directions(w_o, w_i))
    torch.testing.assert_close(there, back, rtol=1e-6, atol=1e-9)


def test_reciprocity_of_plastic():
    w_i, w_o = direction_pairs(100)
    there, back = (
        MODELS["rough-plastic"].evaluate(interior("rough-plastic"), ShadingGeometry.of_directions(*pair))
        for pair in ((w_i, w_o), (w_o, w_i))
    )
    torch.testing.assert_close(there, back, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("name", CHEAP)
def test_gradients_are_those_of_finite_differences(name: str):
    model, geometry = MODELS[name], some_geometry(8)
    names = [p.name for p in model.parameters]
    at = [interior(name)[each].requires_grad_() for each in names]

    def f_r(*values: Tensor) -> Tensor:
        return model.evaluate(dict(zip(names, values, strict=True)), geometry)

    assert torch.autograd.gradcheck(f_r, at, check_forward_ad=True)


@pytest.mark.parametrize("name", ALL)
def test_many_tangents_at_once_are_one_after_the_other(name: str):
    """`torch.func.vmap` over `torch.func.jvp`, against reverse differentiation."""
    model, geometry = MODELS[name], some_geometry(12)
    names = [p.name for p in model.parameters]
    point = torch.cat([interior(name)[each] for each in names])
    widths = [3 if p.colour else 1 for p in model.parameters]

    def f_r(x: Tensor) -> Tensor:
        return model.evaluate(dict(zip(names, x.split(widths), strict=True)), geometry)

    seeds = torch.eye(len(point), dtype=torch.float64)
    together = torch.func.vmap(lambda seed: torch.func.jvp(f_r, (point,), (seed,))[1])(seeds)
    backwards = torch.autograd.functional.jacobian(f_r, point)
    torch.testing.assert_close(together, backwards.movedim(-1, 0), rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("name", CHEAP)
def test_a_batch_is_its_parts(name: str):
    geometry = some_geometry(20)
    one, other = interior(name), MODELS[name].defaults
    both = MODELS[name].evaluate({each: torch.stack([one[each], other[each]]) for each in one}, geometry)
    assert both.shape == (2, 20, 3)
    for index, single in enumerate((one, other)):
        torch.testing.assert_close(both[index], MODELS[name].evaluate(single, geometry))


@pytest.mark.parametrize("name", [name for name in CHEAP if not MODELS[name].channels_coupled])
def test_each_channel_may_have_numbers_of_its_own(name: str):
    model, geometry = MODELS[name], some_geometry(20)
    middle = interior(name)
    spread = {each: value * torch.tensor([1.0, 0.9, 0.8], dtype=torch.float64) for each, value in middle.items()}
    whole = model.evaluate(spread, geometry)
    for channel in range(3):
        alone = model.evaluate({each: value[channel : channel + 1] for each, value in spread.items()}, geometry)
        torch.testing.assert_close(whole[:, channel], alone[:, channel])


@pytest.mark.parametrize("name", [name for name in ALL if MODELS[name].energy_conserving])
def test_white_surroundings_see_no_more_than_white(name: str):
    """At all bounds, and from directions down to 3 degrees above the horizon."""
    model = MODELS[name]
    for ends in ends_of(model, 3 if name == "rough-plastic" else 8):
        for p in model.parameters:  # the integral must resolve the lobe
            if p.name == "roughness":
                ends[p.name] = max(ends[p.name], 0.05)
            if p.name == "sharpness":
                ends[p.name] = min(ends[p.name], 1e3)
        values = {each: torch.tensor([value], dtype=torch.float64) for each, value in ends.items()}
        for cosine in (1.0, 0.5, 0.05):
            assert float(albedo(name, values, cosine).max()) <= 1 + 1e-3, (ends, cosine)


@pytest.mark.parametrize("name", ALL)
def test_defaults_and_starts_lie_within_the_bounds(name: str):
    for p in MODELS[name].parameters:
        assert p.lower < p.upper
        assert all(p.lower <= value <= p.upper for value in (p.default, *p.starts)), p
        assert p.lower > 0 or not p.logarithmic, p
    assert {name: value.shape[0] for name, value in MODELS[name].defaults.items()} == {
        p.name: 3 if p.colour else 1 for p in MODELS[name].parameters
    }


def test_every_source_is_in_the_bibliography():
    keys = set(re.findall(r"@\w+\{(\w+),", (ROOT / "docs" / "references.bib").read_text()))
    assert {model.source for model in MODELS.values()} <= keys


def test_bad_parameters():
    ggx, geometry = MODELS["ggx"], some_geometry(2)
    with pytest.raises(ValueError, match=r"ggx needs the parameters diffuse, specular, roughness, got diffuse"):
        ggx.evaluate({"diffuse": torch.ones(3)}, geometry)
    with pytest.raises(ValueError, match=r"roughness of ggx must be \(\*batch, 1\) or \(\*batch, 3\), got \(2,\)"):
        ggx.evaluate({**ggx.defaults, "roughness": torch.ones(2)}, geometry)
    with pytest.raises(ValueError, match="no analytic model 'phong'; there are lambert, ggx"):
        model_of("phong")
    with pytest.raises(ValueError, match=r"^no analytic model 'roughconductor' \(did you mean rough-conductor\?\);"):
        model_of("roughconductor")
    with pytest.raises(ValueError, match=r"^no analytic model 'GGX' \(did you mean ggx or ggx-dielectric\?\); there"):
        model_of("GGX")
    with pytest.raises(ValueError, match=r"^an analytic model is given by its name, such as 'ggx', got AnalyticModel$"):
        model_of(ggx)
