"""A gradient that a call drops is told, once, where the user called; one that flows, or that nobody wants, is not."""

import warnings
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf.transport import gather_columns, plan_transport
from turns import turn_about

VIEW = tb.SphereView(8)
TURN = turn_about((1, 2, -0.5), 25)

Call = Callable[[tb.MerlTable, tb.LightProbe, tb.MaterialLibrary, Tensor], object]

LOST: dict[str, Call] = {
    "the table's values by the harmonic transport: samples=4096 carries it": lambda table, probe, library, turn: (
        tb.render(table, LIGHT, VIEW)
    ),
    "the probe's radiance by the sampled transport: tb.render without samples carries it": (
        lambda table, probe, library, turn: tb.render(table, probe, VIEW, samples=8)
    ),
    "the probe's radiance with backend='sampled': \"harmonic\" carries it": (
        lambda table, probe, library, turn: tb.render_basis(library, probe, VIEW, samples=8)
    ),
    "the rotation of a light probe: HarmonicBasis.basis_at carries it": (
        lambda table, probe, library, turn: probe.rotated(turn)
    ),
    "the radiance of a light probe through a blur: no call carries it": (
        lambda table, probe, library, turn: probe.blurred(3)
    ),
    'the direction of the light: table.lookup(w_i, w_o, "linear") carries it': (
        lambda table, probe, library, turn: tb.render_directional(table, VIEW, direction=turn[2])
    ),
}
LIGHT = tb.LightProbe.default(16)
KEPT: dict[str, Call] = {
    "radiance by the harmonic transport": lambda table, probe, library, turn: (
        tb.render(library.table("white"), probe, VIEW)
    ),
    "values by the sampled transport": lambda table, probe, library, turn: tb.render(table, LIGHT, VIEW, samples=8),
    "values under a lamp": lambda table, probe, library, turn: tb.render_directional(table, VIEW, 30),
    "radiance of a turned probe": lambda table, probe, library, turn: probe.rotated(TURN).radiance,
}


@pytest.fixture
def given(tiny_library: tb.MaterialLibrary) -> tuple[tb.MerlTable, tb.LightProbe, tb.MaterialLibrary, Tensor]:
    white = tiny_library.table("white")
    table = tb.MerlTable(white.values.clone().requires_grad_(), white.valid)
    probe = tb.LightProbe(LIGHT.radiance.clone().requires_grad_())
    return table, probe, tiny_library, TURN.clone().requires_grad_()


@pytest.mark.parametrize("what", LOST)
def test_a_gradient_that_is_dropped(given: tuple, what: str):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        LOST[what](*given)
    assert [str(warning.message) for warning in caught if what in str(warning.message)] == [
        str(warning.message) for warning in caught
    ]
    assert [warning.filename for warning in caught] == [__file__]
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("error")
        LOST[what](*given)


@pytest.mark.parametrize("what", KEPT)
def test_a_gradient_that_flows(given: tuple, what: str):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        shown = KEPT[what](*given)
    assert isinstance(shown, Tensor)
    wanted = given[0].values if what.startswith("values") else given[1].radiance
    (gradient,) = torch.autograd.grad(shown.double().sum(), [wanted])
    assert bool((gradient != 0).any())


def test_samples_carry_no_gradient_of_their_own(tiny_tables: dict[str, tb.MerlTable]):
    """A picture is linear in the table, so the slope along other values is what the same samples gather of those.

    The table also says where to sample: what the picture would be elsewhere is no part of its slope.
    """
    steel = tiny_tables["steel-0.15"]
    values = steel.values.float().requires_grad_()
    shown = tb.render(tb.MerlTable(values, steel.valid), LIGHT, VIEW, samples=64)
    (gradient,) = torch.autograd.grad(shown.double().sum(), [values])
    plan = plan_transport(steel.filled.float(), LIGHT, VIEW, samples=64, seed=0)
    for name in ("white", "gold-0.3"):
        other = tiny_tables[name]
        gathered = torch.cat([gather_columns(samples, other.filled.float()) for _, samples in plan.blocks()], 1)
        expected = plan.sampler.strata.unit * float(gathered.double().diagonal(dim1=0, dim2=2).sum())
        assert float((gradient * other.values).sum()) == pytest.approx(expected, rel=1e-4)
