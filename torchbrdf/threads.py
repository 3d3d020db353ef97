"""Small operations side by side: threads within each of them would cost more than they gain."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import torch

Part = TypeVar("Part")
Made = TypeVar("Made")


@contextmanager
def one_thread() -> Iterator[int]:
    """One thread for each operation of torch, here and in threads that begin inside. Gives the number there was."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield threads
    finally:
        torch.set_num_threads(threads)


def side_by_side(function: Callable[[Part], Made], parts: Sequence[Part]) -> list[Made]:
    """function(part) of every part in order, as many at once as torch has threads. Nothing of it is differentiated."""
    if min(torch.get_num_threads(), len(parts)) < 2:
        return [function(part) for part in parts]
    with one_thread() as threads, ThreadPoolExecutor(threads) as pool:
        return list(pool.map(torch.no_grad()(function), parts))
