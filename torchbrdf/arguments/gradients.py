"""Gradients that a call would lose without a word."""

import torch
from torch import Tensor

from torchbrdf.arguments.warning import warn


def warn_of_lost_gradient(value: Tensor, what: str, instead: str) -> None:
    """Warn of a value that requires a gradient and gets none, where graphs are recorded.

    what     it is, as the message calls it
    instead  what carries its gradient, as the end of the message
    """
    if value.requires_grad and torch.is_grad_enabled():
        warn(f"no gradient flows to {what}: {instead}")
