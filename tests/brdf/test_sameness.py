import pytest
import torch

from torchbrdf.brdf.merl import MerlTable
from torchbrdf.brdf.merl_grid import N_CELLS
from torchbrdf.brdf.sameness import same_measurements, sampled_cells


def pairs(**tables: MerlTable) -> list[tuple[str, str]]:
    cells = sampled_cells()
    values = torch.cat([table.filled[cells] for table in tables.values()], 1)
    measured = torch.stack([table.valid.reshape(N_CELLS)[cells] for table in tables.values()])
    names = list(tables)
    return [(names[i], names[j]) for i, j in same_measurements(values, measured)]


def test_a_factor_makes_no_other_measurement(tiny_tables: dict[str, MerlTable]):
    gold = tiny_tables["gold-0.3"]
    assert pairs(gold=gold, or_=MerlTable(gold.values / 1500, gold.valid)) == [("gold", "or_")]


@pytest.mark.parametrize(("noise", "same"), [(0.01, True), (0.3, False)])
def test_noise(tiny_tables: dict[str, MerlTable], noise: float, same: bool):
    gold = tiny_tables["gold-0.3"]
    factors = torch.exp(noise * torch.randn(gold.values.shape, generator=torch.Generator().manual_seed(0)))
    assert bool(pairs(gold=gold, noisy=MerlTable(gold.values * factors, gold.valid))) == same


def test_different_materials(tiny_tables: dict[str, MerlTable]):
    names = ("red", "white", "teal", "satin-0.35", "gold-0.3")
    assert pairs(**{name: tiny_tables[name] for name in names}) == []


def test_what_one_of_them_did_not_measure_does_not_count(tiny_tables: dict[str, MerlTable]):
    """A few grazing cells, which the other filled with something else."""
    gold = tiny_tables["gold-0.3"]
    values, valid = gold.values.clone(), gold.valid.clone()
    values[:, 70:], valid[:, 70:] = 0.0, False
    assert pairs(gold=gold, part=MerlTable(values, valid)) == [("gold", "part")]


def test_too_little_in_common_tells_nothing(tiny_tables: dict[str, MerlTable]):
    gold = tiny_tables["gold-0.3"]
    early, late = gold.valid.clone(), gold.valid.clone()
    early[:, 45:], late[:, :45] = False, False
    assert pairs(early=MerlTable(gold.values, early), late=MerlTable(gold.values, late)) == []
