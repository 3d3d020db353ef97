"""What the estimator would make of photographs of the library's own materials."""

from dataclasses import replace

import pytest
import torch

import torchbrdf as tb
from materials import glossy
from torchbrdf.estimation.rehearsal import KINDS, rehearse
from torchbrdf.view import Frames

VIEW = tb.SphereView(16)


@pytest.fixture(scope="module")
def library() -> tb.MaterialLibrary:
    """Twelve plastics of four roughnesses, none of which two others mix."""
    tables = []
    for i in range(12):
        albedo = tuple(0.1 + 0.7 * ((0.381966 * (3 * i + c)) % 1) for c in range(3))
        tables.append(tb.MerlTable.from_function(glossy(albedo, (0.05,) * 3, 0.08 * (1 + i % 4)), f"plastic-{i:02}"))
    return tb.MaterialLibrary.from_tables(tables)


@pytest.fixture(scope="module")
def bases(library: tb.MaterialLibrary) -> dict[str, tb.BasisImages]:
    lights = {"uniform": tb.LightProbe(torch.ones(3, 16, 32)), "room": tb.LightProbe.default(32)}
    lights["turned"] = tb.LightProbe(lights["room"].radiance.roll(20, -1))
    return {name: tb.render_basis(library, light, VIEW, samples=128) for name, light in lights.items()}


@pytest.fixture(scope="module")
def classes(library: tb.MaterialLibrary) -> tb.MaterialClasses:
    return tb.MaterialClasses.fit(library, 2, 2)


def test_a_room_tells_more_than_uniform_light(bases, classes):
    room, uniform = (tb.BRDFEstimator(bases[name], classes).rehearse([bases["turned"]]) for name in ("room", "uniform"))
    assert 0 < room.error < 0.7 * uniform.error


def test_two_photographs_tell_more_than_one(bases, classes):
    one = tb.BRDFEstimator(bases["uniform"], classes).rehearse([bases["turned"]])
    two = tb.BRDFEstimator([bases["uniform"], bases["room"]], classes).rehearse([bases["turned"]])
    assert two.error < 0.6 * one.error


def test_materials_are_recovered_without_themselves(bases, classes):
    """One that is like no other is as far off as these others are, whatever its own columns could do."""
    packed = bases["room"].packed.clone()
    novel = bases["turned"].packed.clone()
    for images in (packed, novel):
        images[:3] *= torch.linspace(0.1, 3, images.shape[-1])  # a material that no combination of others shows
    strange = rehearse(packed, Frames((VIEW.mask,)), [replace(bases["turned"], packed=novel)], classes)
    assert float(strange.errors[0, 0]) > 5 * float(strange.errors[1:, 0].median())


def test_errors_are_by_material_and_light_and_the_same_again(bases, classes):
    estimator = tb.BRDFEstimator(bases["room"], classes)
    found = estimator.rehearse([bases["turned"], bases["uniform"]])
    assert found.errors.shape == (12, 2)
    assert torch.equal(found.errors, estimator.rehearse([bases["turned"], bases["uniform"]]).errors)
    assert found.error == pytest.approx(float(found.errors.mean()))
    assert float(found.errors.max()) <= 1


def test_kinds_are_thirds_by_the_peak(bases, classes):
    found = tb.BRDFEstimator(bases["room"], classes).rehearse([bases["turned"]])
    assert torch.bincount(found.kinds).tolist() == [4, 4, 4]
    norms = classes.norms.view(-1, 3).mean(1)
    assert float(norms[found.kinds == 0].max()) < float(norms[found.kinds == 2].min())
    assert tuple(found.by_kind) == KINDS


def test_verdict_says_what_to_expect(library, bases, classes):
    estimator = tb.BRDFEstimator(bases["room"], classes)
    told, before = estimator.observability(library, [bases["turned"]]), estimator.observability(library)
    assert before.predicted_error is None
    assert told.verdict.startswith(before.verdict)
    assert f"expect an error of {100 * told.predicted_error:.0f} % under other light (dull " in told.verdict


def test_basis_images_of_one_light_need_no_list(library, bases, classes):
    estimator = tb.BRDFEstimator(bases["room"], classes)
    one, listed = (estimator.rehearse(novel).errors for novel in (bases["turned"], [bases["turned"]]))
    assert torch.equal(one, listed)
    assert torch.equal(estimator.observability(library, bases["turned"]).rehearsal.errors, listed)


def test_what_is_printed_is_short(library, bases, classes):
    estimator = tb.BRDFEstimator(bases["room"], classes)
    told = estimator.observability(library, [bases["turned"], bases["uniform"]])
    assert repr(told) == f"Observability({told.verdict})"
    error = f"{100 * told.rehearsal.error:.2f}%"
    assert repr(told.rehearsal) == f"Rehearsal(12 materials, 2 other lights, mean error {error})"


def test_refusals(library, bases, classes):
    estimator = tb.BRDFEstimator(bases["room"], classes)
    with pytest.raises(ValueError, match="give basis images under one at least"):
        estimator.rehearse([])
    with pytest.raises(ValueError, match="come from different libraries"):
        estimator.rehearse([bases["turned"].without(library.names[0])])
