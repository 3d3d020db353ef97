"""What stays in the precision of its tensors, whatever `torch.autocast` says around it."""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import torch

Arguments = ParamSpec("Arguments")
Returned = TypeVar("Returned")


def without_autocast(function: Callable[Arguments, Returned]) -> Callable[Arguments, Returned]:
    """Products in bfloat16 or float16 are off by up to a tenth where a difference of large numbers is sought."""

    @wraps(function)
    def exact(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Returned:
        with torch.autocast("cpu", enabled=False), torch.autocast("cuda", enabled=False):
            return function(*args, **kwargs)

    return exact
