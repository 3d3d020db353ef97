"""Tasks in processes of this machine, none of which outlives the first."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import resource_tracker
from types import FrameType
from typing import NoReturn

from torchbrdf.files import remove_unfinished
from torchbrdf.interruption import uninterrupted
from torchbrdf.sweep.tasks import Call, Finished, Task


def in_processes(call: Call, tasks: Sequence[Task], processes: int) -> Finished:
    """Results of a function as they are finished; ChildProcessError where a process is killed."""
    before = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")  # a fork would share the locks of torch's threads
    pool = ProcessPoolExecutor(processes, mp_context=context, initializer=_end_with_parent)
    try:
        with uninterrupted(), _children_ignore_interrupts():
            futures = {pool.submit(call, task): task for task in tasks}
        for future in as_completed(futures):
            yield futures[future], future.result()
    except BrokenProcessPool:
        raise ChildProcessError(
            "a process of the sweep was killed, perhaps for want of memory; the same command goes on, with fewer "
            "processes if need be"
        ) from None
    finally:
        with uninterrupted():
            pool.shutdown(wait=False, cancel_futures=True)
            for child in set(multiprocessing.active_children()) - before:
                child.terminate()


@contextmanager
def _children_ignore_interrupts() -> Iterator[None]:
    """Processes started here leave Ctrl-C to this one, from their first moment on; pressed meanwhile it comes after."""
    if threading.current_thread() is not threading.main_thread():
        yield
    elif hasattr(signal, "pthread_sigmask"):
        resource_tracker.ensure_running()  # it would unblock the signal once it runs
        pressed = []
        handler = signal.signal(signal.SIGINT, lambda *_: pressed.append(True))  # where another thread receives it
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # what processes inherit
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            signal.signal(signal.SIGINT, handler)
            if pressed:
                signal.raise_signal(signal.SIGINT)
    else:
        handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, handler)


def _end_with_parent() -> None:
    """A child whose parent was killed would wait for tasks for ever. However one ends, no file stays half written."""
    for name in ("SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), _leave)
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        remove_unfinished()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _leave(number: int, _: FrameType | None) -> NoReturn:
    remove_unfinished()
    os._exit(128 + number)
