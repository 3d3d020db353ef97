"""What is made once and lasts longer than the call that needed it first."""

from collections.abc import Callable
from typing import TypeVar

import torch

Made = TypeVar("Made")


def lasting(make: Callable[..., Made]) -> Callable[..., Made]:
    """What is made once enters graphs later, even where it is first needed in `torch.inference_mode`."""
    return torch.inference_mode(False)(torch.no_grad()(make))
