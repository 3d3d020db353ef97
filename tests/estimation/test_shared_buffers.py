import pytest
import torch
from torch import Tensor, nn

from torchbrdf.estimation.shared_buffers import SharedBuffers


class Holder(SharedBuffers):
    """One buffer of each kind."""

    def __init__(self, values: Tensor) -> None:
        super().__init__()
        self.register_buffer("values", values)
        self.register_buffer("fine", values.double())
        self.register_buffer("mask", values > 0.5)


@pytest.fixture
def values() -> Tensor:
    return torch.rand(5, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("cast", ["half", "bfloat16"])
@pytest.mark.parametrize("inside", [False, True])
def test_a_cast_to_a_half_type_rounds_nothing(values: Tensor, cast: str, inside: bool):
    """Nor does one back, from what a network around it was cast to."""
    holder = Holder(values)
    around = nn.ModuleList([nn.Linear(2, 2), holder]) if inside else holder
    for one in (getattr(around, cast)(), around.to(getattr(torch, {"half": "float16"}.get(cast, cast)))):
        assert torch.equal(holder.values, values)
        assert (holder.values.dtype, holder.fine.dtype, holder.mask.dtype) == (torch.float32, torch.float64, torch.bool)
        assert not inside or one[0].weight.dtype.itemsize == 2


def test_a_cast_to_a_half_type_moves(values: Tensor):
    holder = Holder(values).to("meta", torch.bfloat16)
    assert (holder.values.device.type, holder.values.dtype) == ("meta", torch.float32)
    assert holder.mask.device.type == "meta"


def test_casts_to_double_and_float_are_those_of_any_module(values: Tensor):
    holder = Holder(values).double()
    assert holder.values.dtype == torch.float64
    assert torch.equal(holder.values.float(), values)
    assert holder.float().fine.dtype == torch.float32
    assert values.dtype == torch.float32


def test_a_state_is_copied_into_tensors_of_its_own(values: Tensor):
    before, holder = values.clone(), Holder(values)
    holder.load_state_dict(Holder(1 - values).state_dict())
    assert torch.equal(holder.values, 1 - before)
    assert torch.equal(values, before)


def test_what_was_made_in_inference_mode_loads(values: Tensor):
    with torch.inference_mode():
        holder = Holder(values.clone())
    holder.load_state_dict(Holder(1 - values).state_dict())
    assert torch.equal(holder.values, 1 - values)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
@pytest.mark.parametrize("assign", [False, True])
def test_a_rounded_state_is_refused(values: Tensor, dtype: torch.dtype, assign: bool):
    holder = nn.ModuleDict({"estimate": Holder(values)})
    state = {key: one.to(dtype) if one.is_floating_point() else one for key, one in holder.state_dict().items()}
    with pytest.raises(ValueError, match=f"state_dict holds estimate.values in {dtype}, too coarse to estimate with"):
        holder.load_state_dict(state, assign=assign)
    assert torch.equal(holder["estimate"].values, values)
