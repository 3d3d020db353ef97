"""Families of materials, and experiments whose libraries hold none of a target's."""

from dataclasses import replace

import pytest
import torch

from torchbrdf.brdf import MaterialLibrary, MerlTable
from torchbrdf.experiments import (
    BASELINES,
    Experiment,
    Target,
    family,
    relatives,
    without_relatives,
)
from torchbrdf.light import LightProbe

NAMES = ("cc_green", "cc_blue", "chm_orange", "blue-felt", "plastic")
RED = "cc_red_rgb"


@pytest.fixture(scope="module")
def library(tiny_tables: dict[str, MerlTable]) -> MaterialLibrary:
    tables = list(tiny_tables.values())[: len(NAMES)]
    return MaterialLibrary.from_tables([replace(t, name=name) for t, name in zip(tables, NAMES, strict=True)])


@pytest.fixture(scope="module")
def experiment(library: MaterialLibrary) -> Experiment:
    generator = torch.Generator().manual_seed(4)
    lights = {name: LightProbe(torch.rand(3, 8, 16, generator=generator) ** 4) for name in ("one", "two")}
    targets = [
        Target(material, name, light.fingerprint, torch.rand(3, 8, 8, generator=generator), 0.0, {})
        for name, light in lights.items()
        for material in (RED, "cc_green_rgb", "plastic", "satin_purple_rgb")
    ]
    return Experiment.of(library, lights, targets)


@pytest.mark.parametrize(
    ("material", "expected"),
    [
        ("cc_ibiza_sunset_rgb", "cc"),
        ("CC_Green_Malachite", "cc"),
        ("rgl_more/vch_silk_blue_rgb", "vch"),
        ("acrylic_felt_pink", "acrylic_felt"),
        ("irid_flake_paint1_fine_rgb", "irid_flake"),
        ("acrylic", "acrylic"),
        ("blue-acrylic", "blue-acrylic"),
    ],
)
def test_families_are_what_names_begin_with(material: str, expected: str) -> None:
    assert family(material) == expected


def test_relatives_are_of_the_family_or_the_material_itself() -> None:
    assert relatives("cc_green_rgb", NAMES) == ("cc_green", "cc_blue")
    assert relatives("cc_green_rgb", NAMES, "material") == ("cc_green",)
    assert relatives("felt", NAMES) == ()


def test_a_library_without_relatives_is_one_object(library: MaterialLibrary) -> None:
    less = without_relatives(library, RED)
    assert less.names == ("chm_orange", "blue-felt", "plastic")
    assert without_relatives(library, "cc_green") is less
    assert without_relatives(library, "nickel") is library


def test_folds_hold_no_relative_and_every_target_once(experiment: Experiment) -> None:
    folds = experiment.folds("family")
    assert [(fold.materials, fold.library.names) for fold in folds] == [
        (["cc_green_rgb", RED], NAMES[2:]),
        (["plastic"], NAMES[:4]),
        (["satin_purple_rgb"], NAMES),
    ]
    assert all(basis.names == fold.library.names for fold in folds for basis in fold.bases.values())
    assert [fold.library.names for fold in experiment.folds("material")] == [
        ("cc_blue", *NAMES[2:]), NAMES, NAMES[:4]
    ]  # fmt: skip


def test_both_errors_are_told_where_they_differ(experiment: Experiment) -> None:
    assert experiment.relations == ("family", "material")
    alone = experiment.folds("family")[2]
    assert alone.relations == ("family",)
    titles = [one.left_out("family") for one in (experiment, alone)]
    assert titles == ["each without its family", "of no family that the library holds"]


def test_errors_of_a_fold_are_those_of_the_smaller_library(experiment: Experiment) -> None:
    fold = experiment.folds("family")[0]
    alone = Experiment.of(fold.library, fold.probes, [t for some in fold.targets.values() for t in some.values()])
    naive = BASELINES[:1]
    found = [case.novel_error for case in fold.cases(naive, [0])] + [case.novel_error for case in fold.floor()]
    expected = [case.novel_error for case in alone.cases(naive, [0])] + [case.novel_error for case in alone.floor()]
    assert found == pytest.approx(expected, rel=1e-6)


def test_no_error_is_told_of_a_material_that_the_library_holds(experiment: Experiment) -> None:
    message = r"^cc_green is in the library that it is to be recovered from; take `folds` first$"
    with pytest.raises(ValueError, match=message):
        next(experiment.cases(BASELINES[:1], [0]))
    with pytest.raises(ValueError, match=message):
        experiment.floor()
