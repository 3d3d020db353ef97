"""What is not of its type is named in one line, with what to give in its place."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

import torchbrdf as tb
from torchbrdf.arguments import whole
from torchbrdf.learning import ReflectanceMaps, photograph_defects

VIEW = tb.SphereView(8)


@pytest.fixture(scope="module")
def probe() -> tb.LightProbe:
    return tb.LightProbe.default(16)


@pytest.fixture(scope="module")
def white(tiny_tables: dict[str, tb.MerlTable]) -> tb.MerlTable:
    return tiny_tables["white"]


def refused(message: str, call: Callable[..., object], *given: object) -> None:
    with pytest.raises(ValueError) as raised:  # noqa: PT011 - the whole message is compared
        call(*given)
    assert str(raised.value) == message


@pytest.mark.parametrize(("value", "got"), [(1.0, "1.0"), ("1", "'1'"), (None, "None"), ([1], "a list")])
def test_what_is_no_whole_number(value: object, got: str):
    refused(f"steps must be a whole number, got {got}", whole, "steps", value)


@pytest.mark.parametrize("value", [3, np.int64(3), torch.tensor(3)])
def test_whole_numbers_of_any_type(value: object):
    found = whole("steps", value)
    assert found == 3
    assert type(found) is int


def test_a_picture_of_what_is_no_table(probe: tb.LightProbe, tiny_library: tb.MaterialLibrary):
    take = "take result.brdf(library), library.table(name) or tb.read_table(path)"
    for given, called in {"brass": "'brass'", tiny_library: "a MaterialLibrary", None: "None"}.items():
        refused(f"tb.render: table must be a MerlTable, got {called}; {take}", tb.render, given, probe, VIEW)
        message = f"tb.render_directional: table must be a MerlTable, got {called}; {take}"
        refused(message, tb.render_directional, given, VIEW, 30)


def test_arguments_that_are_swapped_or_of_another_type(
    white: tb.MerlTable, probe: tb.LightProbe, tiny_library: tb.MaterialLibrary
):
    order = "the order is tb.render(table, probe, view)"
    refused(f"tb.render: table must be a MerlTable, got a LightProbe; {order}", tb.render, probe, white, VIEW)
    refused(f"tb.render: probe must be a LightProbe, got a SphereView; {order}", tb.render, white, VIEW, probe)
    make = "make one, such as tb.SphereView(32)"
    refused(f"tb.render: view must be a View, got 32; {make}", tb.render, white, probe, 32)
    swapped = "library must be a MaterialLibrary, got a LightProbe; the order is {}(library, probe, view)"
    for call, name in {tb.render_basis: "tb.render_basis", tb.HarmonicBasis: "HarmonicBasis"}.items():
        refused(f"{name}: {swapped.format(name)}", call, probe, tiny_library, VIEW)


def test_training_data_of_what_are_no_basis_images(tiny_library: tb.MaterialLibrary):
    make = "make them with tb.render_basis(library, probe, view)"
    message = f"ReflectanceMaps: basis must be a BasisImages, got a MaterialLibrary; {make}"
    for given in (tiny_library, [tiny_library]):
        refused(message, ReflectanceMaps, given)


@pytest.mark.parametrize("size", [(32, 32), 32.0, "32"])
def test_a_ball_has_one_size(size: object):
    message = f"size of a sphere's image must be one whole number, pixels along a side of the square, got {size!r}"
    refused(message, tb.SphereView, size)


def test_the_second_number_of_a_ball_is_named():
    """SphereView(32, 32) was a ball of 32 pixels in a field of view of 32 degrees."""
    with pytest.raises(TypeError, match="takes 2 positional arguments but 3 were given"):
        tb.SphereView(32, 32)


def test_a_probe_of_what_is_no_picture():
    missing = "light probe must be a tensor or an array (3, H, W), got str; open a file with tb.LightProbe.open(path)"
    refused(missing, tb.LightProbe, "grace.hdr")
    refused("light probe must be a tensor or an array (3, H, W), got list", tb.LightProbe, [1.0, 2.0, 3.0])


def test_defects_of_what_is_no_view():
    message = "photograph_defects: view must be a View, got 24; make one, such as tb.SphereView(32)"
    refused(message, photograph_defects, 24)


def test_defects_of_images_of_another_size():
    """Whether or not one of the images is drawn."""
    images, masks = torch.ones(1, 3, 8, 9), torch.ones(1, 1, 8, 9, dtype=torch.bool)
    message = "images must be 8 x 8 as the view that their defects were made for is, got 8 x 9"
    refused(message, photograph_defects(VIEW), images, masks)


def test_a_function_that_gives_no_colours():
    cells = tb.brdf.above_horizon().sum()
    wanted = f"f_r must give a tensor ({cells}, 3), R, G and B for each pair of directions, got ({cells},)"
    message = f"grey: {wanted}; [..., None] makes one of a grey material's values"
    refused(message, tb.MerlTable.from_function, lambda w_i, w_o: torch.ones(len(w_i)), "grey")
    grey = tb.MerlTable.from_function(lambda w_i, w_o: torch.full((len(w_i), 1), 0.2), "grey")
    assert bool((grey.values[grey.valid] == torch.tensor(0.2).double()).all())
