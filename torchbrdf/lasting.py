"""What is made once and lasts longer than the call that needed it first."""

from collections.abc import Callable, Hashable
from typing import TypeVar

import torch

Key = TypeVar("Key", bound=Hashable)
Made = TypeVar("Made")


def lasting(make: Callable[..., Made]) -> Callable[..., Made]:
    """What is made once enters graphs later, even where it is first needed in `torch.inference_mode`."""
    return torch.inference_mode(False)(torch.no_grad()(make))


class LastFew(dict[Key, Made]):
    """What was made last, by what it was made of: at most `count` of them."""

    def __init__(self, count: int) -> None:
        """Nothing is made yet."""
        super().__init__()
        self.count = count

    def get_or_make(self, key: Key, make: Callable[[], Made]) -> Made:
        """What was made of a key; else it is made now, in the place of the oldest where there are enough."""
        if key not in self:
            made = make()
            while len(self) >= self.count:
                del self[next(iter(self))]
            self[key] = made
        return self[key]
