"""Rendering by a sparse matrix over cells: against `render`, linear, and differentiable."""

import pytest
import torch
from torch import Tensor

import torchbrdf as tb
from bsdf_cases import interior, numbers
from torchbrdf.analytic.catalogue import MODELS
from torchbrdf.analytic.cell_transport import CellTransport
from torchbrdf.analytic.shading_geometry import ShadingGeometry
from torchbrdf.rendering.tables import render_tables


@pytest.fixture(scope="module")
def probe() -> tb.LightProbe:
    return tb.LightProbe.default(64)


@pytest.fixture(scope="module")
def transport(probe: tb.LightProbe) -> CellTransport:
    return CellTransport.build(probe, tb.SphereView(24), samples=4096)


@pytest.fixture(scope="module")
def small(probe: tb.LightProbe) -> CellTransport:
    return CellTransport.build(probe, tb.SphereView(6), samples=64)


def table_of(model: str, parameters: dict[str, Tensor]) -> tb.MerlTable:
    return tb.MerlTable.from_function(
        lambda w_i, w_o: MODELS[model].evaluate(parameters, ShadingGeometry.of_directions(w_i, w_o)), model
    )


CASES = {
    "lambert": ("lambert", numbers(diffuse=(0.8, 0.4, 0.1))),
    "glossy": ("ggx", numbers(diffuse=(0.3, 0.2, 0.1), specular=(0.05, 0.04, 0.06), roughness=0.15)),
    "metal": ("ggx", numbers(diffuse=0, specular=(0.9, 0.6, 0.3), roughness=0.06)),
    "sheen": ("principled", interior("principled")),
}


@pytest.fixture(scope="module")
def tables() -> dict[str, tb.MerlTable]:
    return {case: table_of(model, parameters) for case, (model, parameters) in CASES.items()}


@pytest.fixture(scope="module")
def rendered(tables: dict[str, tb.MerlTable], transport: CellTransport, probe: tb.LightProbe) -> dict[str, Tensor]:
    """By the renderer of tables."""
    images = render_tables(list(tables.values()), probe, transport.view, samples=16384, seed=1)
    return {case: transport.view.pack(image).T for case, image in zip(tables, images, strict=True)}


@pytest.mark.parametrize("case", CASES)
def test_renders_as_render(
    transport: CellTransport, tables: dict[str, tb.MerlTable], rendered: dict[str, Tensor], case: str
):
    """Of the model at the geometry, and of a table looked up at the cells."""
    model, parameters = CASES[case]
    table, wanted = tables[case], rendered[case]
    for f_r in (MODELS[model].evaluate(parameters, transport.geometry), transport.values(table)):
        shown = transport.render(f_r)
        assert shown.shape == wanted.shape == (len(transport.view.pixels), 3)
        assert shown.dtype == torch.float32
        assert float((shown - wanted).norm() / wanted.norm()) < 0.005


def test_white_furnace():
    """A Lambertian sphere under radiance 1 reflects its albedo in every pixel."""
    view = tb.SphereView(16)
    transport = CellTransport.build(tb.LightProbe(torch.ones(3, 32, 64)), view)
    albedo = torch.tensor([0.8, 0.4, 0.1])
    shown = transport.render((albedo / torch.pi).expand(len(transport.cells), 3))
    torch.testing.assert_close(shown, albedo.expand_as(shown), rtol=0.01, atol=0)


def test_colour_of_the_light():
    """Each channel is lit by its own."""
    light = torch.tensor([1.0, 0.5, 0.0])
    transport = CellTransport.build(tb.LightProbe(light[:, None, None].expand(3, 32, 64)), tb.SphereView(12))
    red, green, blue = transport.render(torch.ones(len(transport.cells), 3)).unbind(-1)
    torch.testing.assert_close(green, 0.5 * red, rtol=1e-4, atol=0)
    assert not blue.any()
    assert (red > 0).all()


def test_linear_and_batched(small: CellTransport):
    f_r = torch.rand(2, 3, len(small.cells), 3, generator=torch.Generator().manual_seed(0))
    shown = small.render(f_r)
    assert shown.shape == (2, 3, len(small.view.pixels), 3)
    torch.testing.assert_close(shown[1, 2], small.render(f_r[1, 2]))
    torch.testing.assert_close(small.render(2 * f_r[0] - 3 * f_r[1]), 2 * shown[0] - 3 * shown[1], rtol=1e-4, atol=1e-4)
    assert small.render(f_r[:0]).shape == (0, 3, len(small.view.pixels), 3)


def test_channels_do_not_mix(small: CellTransport):
    f_r = torch.zeros(len(small.cells), 3)
    f_r[:, 1] = 1
    red, green, blue = small.render(f_r).unbind(-1)
    assert not red.any()
    assert not blue.any()
    assert (green > 0).all()


def test_gradient_is_the_transpose(small: CellTransport):
    """Against the matrices themselves."""
    generator = torch.Generator().manual_seed(1)
    f_r = torch.rand(2, len(small.cells), 3, generator=generator).requires_grad_()
    weights = torch.rand(2, len(small.view.pixels), 3, generator=generator)
    (gradient,) = torch.autograd.grad((weights * small.render(f_r)).sum(), f_r)
    for c, matrix in enumerate(small.matrices):
        wanted = weights[..., c].double() @ torch.from_numpy(matrix.toarray()).double()
        torch.testing.assert_close(gradient[..., c].double(), wanted, rtol=1e-4, atol=1e-6)


def test_gradient_by_parameters_against_finite_differences(small: CellTransport):
    def loss(roughness: Tensor) -> Tensor:
        parameters = {**CASES["glossy"][1], "roughness": roughness}
        return small.render(MODELS["ggx"].evaluate(parameters, small.geometry)).double().square().sum()

    at = torch.tensor([0.2], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(loss(at), at)
    step = 5e-3
    wanted = (loss(at.detach() + step) - loss(at.detach() - step)) / (2 * step)
    assert float(slope) == pytest.approx(float(wanted), rel=1e-2)


def test_second_derivatives(small: CellTransport):
    """Of |A f|^2: 2 A^T A."""
    f_r = torch.rand(len(small.cells), 3, generator=torch.Generator().manual_seed(2)).requires_grad_()
    (gradient,) = torch.autograd.grad(small.render(f_r).square().sum(), f_r, create_graph=True)
    direction = torch.rand(f_r.shape, generator=torch.Generator().manual_seed(3))
    (found,) = torch.autograd.grad((gradient * direction).sum(), f_r)
    (wanted,) = torch.autograd.grad((2 * small.render(direction) * small.render(f_r)).sum(), f_r)
    torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-5)


def test_cells_are_where_the_geometry_is(transport: CellTransport, tables: dict[str, tb.MerlTable]):
    """A smooth table looked up at the cells is the model at the geometry, nearly."""
    model, parameters = CASES["glossy"]
    looked_up = transport.values(tables["glossy"]).float()
    exact = MODELS[model].evaluate(parameters, transport.geometry).float()
    assert float((looked_up - exact).norm() / exact.norm()) < 0.02
    assert bool(transport.geometry.above.all())


def test_same_seed_same_matrices_and_no_random_numbers(probe: tb.LightProbe, small: CellTransport):
    before = torch.random.get_rng_state()
    again = CellTransport.build(probe, tb.SphereView(6), samples=64)
    other = CellTransport.build(probe, tb.SphereView(6), samples=64, seed=1)
    assert torch.equal(torch.random.get_rng_state(), before)
    f_r = torch.ones(len(small.cells), 3)
    assert torch.equal(again.cells, small.cells)
    assert torch.equal(again.render(f_r), small.render(f_r))
    assert not torch.equal(other.render(torch.ones(len(other.cells), 3)), small.render(f_r))
