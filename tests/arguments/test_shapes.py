"""Tensors of another shape are named with the shape that is wanted."""

import pytest
import torch

from torchbrdf.arguments import check_last


@pytest.mark.parametrize("shape", [(3,), (0, 3), (2, 5, 3)])
def test_any_number_of_axes_may_stand_before_the_last(shape: tuple[int, ...]):
    check_last(torch.zeros(shape), 3, "w_i")


@pytest.mark.parametrize("shape", [(), (4,), (3, 5), (3, 1)])
def test_another_last_axis(shape: tuple[int, ...]):
    with pytest.raises(ValueError) as raised:  # noqa: PT011 - the whole message is compared
        check_last(torch.zeros(shape), 3, "w_i")
    assert str(raised.value) == f"w_i must be (..., 3), got {shape}"
