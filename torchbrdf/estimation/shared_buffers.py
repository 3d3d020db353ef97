"""Modules that hold the very tensors of others, and in which those stay as they are."""

from collections.abc import Callable
from typing import Any, Self

import torch
from torch import Tensor, nn


class SharedBuffers(nn.Module):
    """A module without parameters whose buffers may be the tensors of others: it replaces them, never writes into them.

    Nor does it round them: a cast to a type below float32 moves a buffer and leaves its type alone, so that a network
    that is cast to one may hold the module.
    """

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        """Move and convert, see `nn.Module.to`."""

        def moved(buffer: Tensor) -> Tensor:
            made = fn(buffer)
            return buffer.to(made.device) if _is_rounded(made) else made

        return super()._apply(moved, recurse)

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *rest: Any) -> None:
        """Copy a state into tensors of the module's own, see `nn.Module.load_state_dict`.

        Raises ValueError where the state was rounded to a type below float32.
        """
        for name, buffer in self.named_buffers(recurse=False, remove_duplicate=False):
            loaded = state_dict.get(prefix + name)
            if isinstance(loaded, Tensor) and _is_rounded(loaded):
                raise ValueError(
                    f"this state_dict holds {prefix}{name} in {loaded.dtype}, too coarse to estimate with; "
                    "save it as the module gives it, in float32 or float64"
                )
            self._buffers[name] = buffer.clone()
        super()._load_from_state_dict(state_dict, prefix, *rest)


def _is_rounded(values: Tensor) -> bool:
    return values.is_floating_point() and torch.finfo(values.dtype).bits < 32
