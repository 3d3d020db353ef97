from math import pi

import pytest
import torch

from columns import all_values, tiny_bounds
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import GRID, N_CELLS, MerlTable, above_horizon
from torchbrdf.estimation.energy_bounds import EnergyBounds, depth_below_zero


@pytest.fixture(scope="module")
def bounds(tiny_library: MaterialLibrary) -> EnergyBounds:
    return tiny_bounds(tiny_library)


def test_lambert_has_its_albedo(bounds: EnergyBounds, tiny_library: MaterialLibrary):
    """To the precision of the stored columns: the rule's weights sum to pi."""
    white = 3 * tiny_library.position("white")
    expected = torch.tensor([0.8, 0.8, 0.75], dtype=torch.float64).expand(30, 3)
    assert torch.allclose(bounds.albedo[:, white : white + 3], expected, rtol=5e-4)


@pytest.mark.parametrize(("name", "rtol"), [("satin-0.35", 0.01), ("plastic-0.1", 0.02), ("copper-0.08", 0.03)])
def test_albedo_by_monte_carlo(
    bounds: EnergyBounds, tiny_library: MaterialLibrary, tiny_tables: dict[str, MerlTable], name: str, rtol: float
):
    """Against uniform directions in polar angles about the mirror direction, which share nothing with the rule."""
    g = torch.Generator().manual_seed(5)
    n, column = 400_000, 3 * tiny_library.position(name)
    for k in (0, 10, 20, 27):
        angle = torch.tensor((k + 0.5) * pi / 60, dtype=torch.float64)
        mirror = torch.stack([-torch.sin(angle), torch.zeros_like(angle), torch.cos(angle)])
        side = torch.stack([torch.cos(angle), torch.zeros_like(angle), torch.sin(angle)])
        other = torch.linalg.cross(mirror, side)
        radius = pi * torch.rand(n, 1, generator=g, dtype=torch.float64) ** 2  # denser near the mirror direction
        turn = 2 * pi * torch.rand(n, 1, generator=g, dtype=torch.float64)
        w_i = torch.cos(radius) * mirror + torch.sin(radius) * (torch.cos(turn) * side + torch.sin(turn) * other)
        density = 1 / (4 * pi**2 * torch.sin(radius) * torch.sqrt(radius / pi))
        w_o = torch.stack([torch.sin(angle), torch.zeros_like(angle), torch.cos(angle)]).expand(n, 3)
        values = tiny_tables[name].lookup(w_i, w_o) * w_i[:, 2:].clamp_min(0) / density
        error = values.std(0) / n**0.5
        difference = (bounds.albedo[k, column : column + 3] - values.mean(0)).abs()
        assert (difference < 4 * error + rtol * values.mean(0)).all()
        assert (error < rtol * values.mean(0)).all()


def test_scan_sees_every_cell(bounds: EnergyBounds, tiny_library: MaterialLibrary):
    weights = torch.randn(4, 30, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    weights[3] = weights[3].abs()
    depth, cells = bounds.scan(weights, 1e-6)
    value, size = all_values(tiny_library, weights), all_values(tiny_library, weights.abs())
    expected = (-value / size.clamp_min(1e-300))[above_horizon().ravel()].amax(0)
    assert torch.allclose(depth, expected.clamp_min(0), atol=1e-6)
    assert expected[3] < 0 < expected[0]
    assert above_horizon().ravel()[cells].all()
    assert (value[cells, :3] < 0).any(1).all()
    assert torch.equal(cells, torch.unique(cells))
    assert len(bounds.scan(weights[3:], 1e-6)[1]) == 0


def test_a_single_cell_is_found(tiny_tables: dict[str, MerlTable]):
    """One cell in a million below zero, at the end of the grid's rows, in one of two programs."""
    cell = int(torch.nonzero(above_horizon().ravel())[-1])
    values = tiny_tables["white"].values.clone()
    values.view(N_CELLS, 3)[cell] = 2.0
    library = MaterialLibrary.from_tables([tiny_tables["white"], MerlTable(values, above_horizon(), "spike")])
    bounds = EnergyBounds.of(library, view_angles=0)
    weights = torch.tensor([[1.0, 0, 0, -0.5, 0, 0], [1.0, 0, 0, 0, 0, 0]], dtype=torch.float64)
    depth, cells = bounds.scan(weights, 1e-6)
    assert cells.tolist() == [cell]
    assert depth[0] > 0.5
    assert depth[1] == 0


def test_rows_are_the_library_s_values(bounds: EnergyBounds, tiny_library: MaterialLibrary):
    cells = torch.tensor([5, 400_000, 777_777])
    expected = tiny_library.table("gold-0.3").values.reshape(N_CELLS, 3)[cells]
    gold = 3 * tiny_library.position("gold-0.3")
    assert torch.allclose(bounds.rows(cells)[:, gold : gold + 3], expected, rtol=1e-12)
    assert torch.equal(bounds.rows(bounds.cells), bounds.thinned.double())


def test_of_a_part_equals_a_part_of_the_whole(bounds: EnergyBounds, tiny_library: MaterialLibrary):
    names = ["steel-0.15", "white"]
    members = torch.cat([3 * tiny_library.position(name) + torch.arange(3) for name in names])
    part, selected = EnergyBounds.of(tiny_library.subset(names)), bounds.select(members)
    weights = torch.randn(2, 6, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    assert torch.equal(part.thinned, selected.thinned)
    assert torch.allclose(part.albedo, selected.albedo, rtol=1e-12)
    for one, other in zip(part.scan(weights, 1e-6), selected.scan(weights, 1e-6), strict=True):
        assert torch.allclose(one, other)


def test_unmeasured_cells_do_not_count(tiny_tables: dict[str, MerlTable]):
    """Cells that no material measured are left out, those that one did are kept."""
    white, red = tiny_tables["white"], tiny_tables["red"]
    neither, either = above_horizon().clone(), above_horizon().clone()
    neither[:, 10:20] = False
    either[:, 30:40] = False
    library = MaterialLibrary.from_tables(
        [MerlTable(white.values, neither & either, "white"), MerlTable(red.values, neither, "red")]
    )
    bounds = EnergyBounds.of(library, view_angles=2)
    assert torch.equal(bounds.usable.reshape(GRID), neither)
    assert bounds.usable[bounds.cells].all()
    assert bounds.albedo.shape == (2, 6)


def test_depth_without_terms_is_zero():
    product = torch.tensor([[-1.0, 0.0, 2.0, 0.0], [3.0, 0.0, 3.0, 5.0]])
    assert depth_below_zero(product, 2).tolist() == [[0.5, 0.0], [-1.0, 0.0]]


def test_bad_input(tiny_library: MaterialLibrary):
    with pytest.raises(ValueError, match="view_angles must be at least 0, got -1"):
        EnergyBounds.of(tiny_library, view_angles=-1)


def test_repr(bounds: EnergyBounds):
    assert repr(bounds) == f"EnergyBounds(30 columns, {int(above_horizon().sum())} cells, 30 angles)"
