"""Threads of one computation: its parts side by side, each with one thread of torch, so that sums keep their order."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
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
    """function(part) of every part in order, as many at once as torch has threads. Nothing of it is differentiated.

    This thread works, too: the memory that it let go of before is at hand for no other.
    """
    if min(torch.get_num_threads(), len(parts)) < 2:
        return [function(part) for part in parts]
    with one_thread() as threads, ThreadPoolExecutor(threads - 1) as pool:
        apart = torch.no_grad()(function)
        futures = [pool.submit(apart, part) for part in parts]
        try:
            for i, future in enumerate(futures):
                if future.cancel():  # no other thread has begun it
                    futures[i] = _made_here(apart, parts[i])
                    if futures[i].exception():
                        break
            return [future.result() for future in futures]
        finally:
            for future in futures:
                future.cancel()


def _made_here(function: Callable[[Part], Made], part: Part) -> "Future[Made]":
    """Of this thread, as of another."""
    future: Future[Made] = Future()
    try:
        future.set_result(function(part))
    except Exception as error:
        future.set_exception(error)
    return future
