"""Integrals over boxes and their derivatives."""

import torch

from torchbrdf.photograph._summed_area import Boxes, SummedArea


def boxes(*sides: float) -> Boxes:
    return Boxes(*(torch.tensor([side], dtype=torch.float64, requires_grad=True) for side in sides))


def test_whole_and_cut_pixels_count_by_area():
    picture = torch.tensor([[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]])
    assert SummedArea(picture).over(boxes(0.5, 2.25, 0.5, 2.0)).item() == 0.25 * 1 + 0.5 * 2 + 0.125 * 3 + 2 + 5 + 1.5


def test_outside_the_picture_is_nothing():
    assert SummedArea(torch.ones(1, 2, 3)).over(boxes(-5.0, 1.0, -5.0, 9.0)).item() == 2.0


def test_derivatives_are_the_radiance_along_the_sides():
    picture, box = torch.rand(1, 6, 7, generator=torch.Generator().manual_seed(0)), boxes(1.3, 4.6, 0.7, 5.2)
    SummedArea(picture).over(box).sum().backward()
    rows = torch.tensor([0.3, 1, 1, 1, 1, 0.2])
    columns = torch.tensor([0, 0.7, 1, 1, 0.6, 0, 0])
    for side, expected in (
        (box.left, -(rows * picture[0, :, 1]).sum()),
        (box.right, (rows * picture[0, :, 4]).sum()),
        (box.top, -(columns * picture[0, 0]).sum()),
        (box.bottom, (columns * picture[0, 5]).sum()),
    ):
        assert side.grad is not None
        assert torch.allclose(side.grad, expected.double())
