"""Modules that hold the very tensors of others, and in which those stay as they are."""

from typing import Any

from torch import nn


class SharedBuffers(nn.Module):
    """A module whose buffers may be the tensors of others: it replaces them, and never writes into them."""

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *rest: Any) -> None:
        """Copy a state into tensors of the module's own, see `nn.Module.load_state_dict`."""
        for name, buffer in self.named_buffers(recurse=False, remove_duplicate=False):
            self._buffers[name] = buffer.clone()
        super()._load_from_state_dict(state_dict, prefix, *rest)
