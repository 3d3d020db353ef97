"""Tucker decompositions of logarithms of BRDFs, and the embedded library that is one."""

from collections.abc import Callable
from dataclasses import replace
from math import pi
from pathlib import Path

import pytest
import torch

from paths import ROOT
from torchbrdf.brdf.difference import cell_difference
from torchbrdf.brdf.merl import GRID, MerlTable, above_horizon
from torchbrdf.brdf.merl_directory import MERL_MATERIALS
from torchbrdf.brdf.tucker import DEFAULT_FILE, FLOOR, TuckerFactors, load_default_factors, logarithm


@pytest.fixture(scope="module")
def embedded() -> tuple[tuple[str, ...], TuckerFactors]:
    return load_default_factors()


def table(embedded: tuple[tuple[str, ...], TuckerFactors], name: str) -> MerlTable:
    names, factors = embedded
    own = factors.subset(3 * names.index(name) + torch.arange(3))
    return MerlTable(torch.stack([own.row(i) for i in range(GRID[0])]).view(*GRID, 3), above_horizon(), name)


def test_a_row_is_the_sum_of_its_terms() -> None:
    """One term of each of two columns."""
    profiles = [torch.rand(length, 2, generator=torch.Generator().manual_seed(i)) for i, length in enumerate(GRID)]
    terms = torch.tensor([[0, 1, 0], [1, 0, 1]], dtype=torch.int16)
    factors = TuckerFactors(*profiles, terms, torch.tensor([[4, 0], [0, 6]]).short(), torch.tensor([0.5, 0.25]))
    h, d, p = profiles
    sums = torch.stack([2 * h[7, 0] * d[:, 1, None] * p[:, 0], 1.5 * h[7, 1] * d[:, 0, None] * p[:, 1]], -1)
    torch.testing.assert_close(factors.row(7), FLOOR * torch.expm1(sums.flatten(0, 1)), rtol=1e-5, atol=1e-9)


def test_the_logarithm_is_undone() -> None:
    f_r = torch.tensor([0.0, 1e-5, 0.3, 1e4], dtype=torch.float64)
    torch.testing.assert_close(FLOOR * torch.expm1(logarithm(f_r)), f_r)


def test_the_embedded_library_is_complete_and_small(embedded: tuple[tuple[str, ...], TuckerFactors]) -> None:
    names, factors = embedded
    assert set(names[:100]) == set(MERL_MATERIALS)
    assert len(set(names)) == 116
    assert factors.quantised.shape == (len(factors.terms), 3 * len(names))
    assert (ROOT / "torchbrdf" / "brdf" / DEFAULT_FILE).stat().st_size <= 6_000_000


def test_the_notice_names_the_materials_of_the_rgl_database(embedded: tuple[tuple[str, ...], TuckerFactors]) -> None:
    notice = (ROOT / "NOTICE").read_text()
    listed = notice[notice.index("EPFL.") + 5 :].replace(",", " ").split()
    assert sorted(listed) == sorted(set(embedded[0]) - set(MERL_MATERIALS))


def test_no_embedded_material_reflects_more_than_it_gets(embedded: tuple[tuple[str, ...], TuckerFactors]) -> None:
    """Albedo at normal incidence, along theta_h = theta_d = theta_i / 2 and phi_d = 0."""
    names, factors = embedded
    plane = replace(factors, phi_d=factors.phi_d[:1])
    rows = torch.stack([plane.row(i) for i in range(GRID[0])])
    t = (torch.arange(4000, dtype=torch.float64) + 0.5) / 4000
    theta_i = t**2 * pi / 2
    weight = 2 * pi * torch.sin(theta_i) * torch.cos(theta_i) * pi * t / 4000
    h, d = ((x * 90).long() for x in (torch.sqrt(theta_i / pi), theta_i / pi))
    assert len(names) == 116
    assert (weight @ rows[h, d].double()).max() < 1.0


HARD = ["chrome", "polyethylene", "black-obsidian", "nylon"]


@pytest.fixture(scope="module")
def decoded(decode: Callable[..., Path]) -> Path:
    return decode(*HARD)


@pytest.mark.parametrize("name", HARD)
def test_embedded_materials_are_those_they_encode(
    name: str, decoded: Path, embedded: tuple[tuple[str, ...], TuckerFactors]
) -> None:
    """The worst of each metric, and two that were hard for analytic lobes."""
    few = torch.zeros(GRID, dtype=torch.bool)
    few[..., 2::4] = True  # f_r is smooth along phi_d
    encoded, reference = table(embedded, name), MerlTable.open(decoded / f"{name}.binary")
    reference = replace(reference, valid=reference.valid & few)
    bounds = {"l2": 0.04, "log": 0.04, "cube-root": 0.09}
    assert all(cell_difference(encoded, reference, metric) < bound for metric, bound in bounds.items())
