"""Modules that hold the very tensors of others, and in which those stay as they are."""

from collections.abc import Callable, Mapping
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
        """Copy a state into tensors of the module's own, see `nn.Module.load_state_dict`; nothing where it is refused.

        Raises ValueError, see `_check_state`.
        """
        self._check_state(state_dict, prefix)
        for name, buffer in self.named_buffers(recurse=False, remove_duplicate=False):
            self._buffers[name] = buffer.clone()
        super()._load_from_state_dict(state_dict, prefix, *rest)

    def _check_state(self, state_dict: Mapping[str, Any], prefix: str) -> None:
        """Raise ValueError where a state does not fit this module and those in it.

        That is where a tensor is none, of another shape, or of a type below float32, and where some names are absent
        and what is there is not what the module has already.
        """
        own = self.state_dict()
        given = {name: state_dict[prefix + name] for name in own if prefix + name in state_dict}
        absent = [prefix + name for name in own if name not in given]
        if absent and not all(_are_same(value, own[name]) for name, value in given.items()):
            raise ValueError(
                f"this state_dict holds only a part of what another {type(self).__name__} is, without "
                f"{', '.join(absent)}; load the whole state of one, or leave all of it out"
            )
        for name, loaded in given.items():
            if not isinstance(own[name], Tensor):
                continue
            shape = tuple(own[name].shape)
            if not isinstance(loaded, Tensor) or tuple(loaded.shape) != shape:
                found = tuple(loaded.shape) if isinstance(loaded, Tensor) else type(loaded).__name__
                raise ValueError(f"this state_dict holds {found} as {prefix}{name}, expected {shape}")
            if _is_rounded(loaded):
                raise ValueError(
                    f"this state_dict holds {prefix}{name} in {loaded.dtype}, too coarse to estimate with; "
                    "save it as the module gives it, in float32 or float64"
                )


def _are_same(given: Any, own: Any) -> bool:
    if isinstance(own, Tensor):
        return isinstance(given, Tensor) and torch.equal(given.to(own), own)
    return bool(given == own)


def _is_rounded(values: Tensor) -> bool:
    return values.is_floating_point() and torch.finfo(values.dtype).bits < 32
