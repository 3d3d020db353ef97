"""Sweeps: many independent tasks, on this machine or on a Dask cluster, each finished one kept in a file of its own.

A task calls a pure function of an importable module with arguments that JSON holds, and gets a result that JSON holds.
Every task computes with one torch thread, wherever it runs: sums are then done in one order, so a sweep gives the same
bits in this process, in several and on a cluster of like machines, and several processes use the cores better than
several threads. `side_by_side` does the same with the parts of one computation, in threads of one process.
"""

import hashlib
import importlib
import json
import logging
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed as completed_here
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn, TypeVar

import torch
from tqdm import tqdm

from torchbrdf._version import __version__
from torchbrdf.files import remove_unfinished, writing
from torchbrdf.interruption import uninterrupted

_CONNECT_SECONDS = 10

Finished = Generator[tuple["Task", Any], None, None]
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


@dataclass(frozen=True)
class Task:
    """One call of the sweep's function, with `**arguments, **places`.

    name       also of the file of its result
    arguments  all that the result depends on
    places     where things lie, such as paths of what `arguments` holds fingerprints of: they may change between runs
    """

    name: str
    arguments: Mapping[str, Any]
    places: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Call:
    """A function by name, so that any process can find it.

    folder    where its module (or the module's package) lies
    versions  of torchbrdf and torch, which must be the same in all processes
    """

    module: str
    function: str
    folder: str
    versions: tuple[str, str]

    @classmethod
    def of(cls, function: Callable[..., Any]) -> "Call":
        """Raises ValueError for a function that other processes cannot import by its name."""
        module, name = function.__module__, function.__qualname__
        if module == "__main__" or not name.isidentifier():
            raise ValueError(f"a sweep needs a function of a module that can be imported, got {module}.{name}")
        file = Path(str(sys.modules[module].__file__)).resolve()
        return cls(module, name, str(file.parents[module.count(".")]), versions())

    def __call__(self, task: Task) -> Any:
        """The result of a task, in any process."""
        if versions() != self.versions:
            raise ValueError(
                "processes of a sweep must have the same torchbrdf and torch, got "
                f"{', '.join(versions())} on a worker and {', '.join(self.versions)} here"
            )
        if self.folder not in sys.path:
            sys.path.append(self.folder)
        function = getattr(importlib.import_module(self.module), self.function)
        with one_thread():
            return function(**task.arguments, **task.places)


def versions() -> tuple[str, str]:
    """Of torchbrdf and torch."""
    return __version__, torch.__version__


def sweep(
    function: Callable[..., Any],
    tasks: Sequence[Task],
    folder: str | os.PathLike[str],
    processes: int = 1,
    scheduler: str | None = None,
    progress: str = "tasks",
) -> dict[str, Any]:
    """Results of all tasks by name; those that `folder` holds already are read, not computed again.

    function   pure, of an importable module; remember what is slow to open with `functools.lru_cache`
    folder     one NAME.json a finished task, written whole or not at all; made where it does not exist
    processes  on this machine; 1 computes in this one
    scheduler  address of a Dask scheduler whose workers compute instead, such as tcp://node:8786. They need this
               torchbrdf, and must see the folder of the function's module and the tasks' `places` under the same paths
    progress   label of the bar
    Raises ValueError where two tasks share a name, or the folder holds a result of other arguments, another function or
    another version; what the function raises; ChildProcessError where processes are killed; ConnectionError without a
    scheduler. After an error, or Ctrl-C, the same call goes on where it stopped.
    """
    names = [task.name for task in tasks]
    if len(set(names)) < len(names):
        raise ValueError(f"tasks must have different names; twice: {max(names, key=names.count)}")
    if processes < 1:
        raise ValueError(f"a sweep needs at least one process, got {processes}")
    call, folder = Call.of(function), Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {}
    open_tasks = []
    for task in tasks:
        found = _stored(folder / f"{task.name}.json", _identity(call, task))
        if found is None:
            open_tasks.append(task)
        else:
            results[task.name] = found["result"]
    with tqdm(total=len(tasks), initial=len(results), desc=progress) as bar:
        if open_tasks:
            with closing(_finished(call, open_tasks, processes, scheduler)) as finished:
                for task, result in finished:
                    text = json.dumps({"of": _identity(call, task), "result": result})
                    with writing(folder / f"{task.name}.json") as temporary:
                        temporary.write_text(text)
                    results[task.name] = json.loads(text)["result"]  # as it will be when it is read
                    bar.update()
    return {name: results[name] for name in names}


def _finished(call: Call, tasks: Sequence[Task], processes: int, scheduler: str | None) -> Finished:
    if scheduler is not None:
        return _on_cluster(call, tasks, scheduler)
    if processes == 1:
        return ((task, call(task)) for task in tasks)
    return _in_processes(call, tasks, min(processes, len(tasks)))


def _identity(call: Call, task: Task) -> dict[str, str]:
    """What a result is of: the function, the version, and a hash of every argument."""
    texts = {key: json.dumps(value, sort_keys=True) for key, value in task.arguments.items()}
    hashes = {key: hashlib.sha256(text.encode()).hexdigest()[:16] for key, text in texts.items()}
    return {"function": f"{call.module}.{call.function}", "version": call.versions[0], **hashes}


def _stored(path: Path, identity: Mapping[str, str]) -> dict[str, Any] | None:
    """A finished result; None where there is none, or a damaged file."""
    try:
        found: dict[str, Any] = json.loads(path.read_text())
        of = found["of"]
    except (FileNotFoundError, ValueError, KeyError, TypeError):
        return None
    changed = [key for key in {**identity, **of} if of.get(key) != identity.get(key)]
    if changed:
        raise ValueError(f"{path} holds the result of another {changed[0]}; choose another output folder")
    return found


def _in_processes(call: Call, tasks: Sequence[Task], processes: int) -> Finished:
    before = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")  # a fork would share the locks of torch's threads
    pool = ProcessPoolExecutor(processes, mp_context=context, initializer=_end_with_parent)
    try:
        with uninterrupted(), _children_ignore_interrupts():
            futures = {pool.submit(call, task): task for task in tasks}
        for future in completed_here(futures):
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


def _on_cluster(call: Call, tasks: Sequence[Task], address: str) -> Finished:
    try:
        import distributed
    except ImportError:
        raise ValueError("a scheduler needs dask.distributed: pip install 'torchbrdf[cluster]'") from None
    try:
        client = distributed.Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise ConnectionError(
            f"no Dask scheduler answers at {address} ({type(error).__name__}); start one with `dask scheduler`, "
            "workers with `dask worker ADDRESS --nthreads 1`, and give its address"
        ) from None
    log = logging.getLogger("distributed.client")  # says at length what one line below says
    level = log.level
    log.setLevel(logging.CRITICAL)
    try:
        with client:
            yield from _computed(client, call, tasks)
    except distributed.KilledWorker:
        raise ChildProcessError(
            f"{address}: workers were killed again and again in the same task, perhaps for want of memory; the same "
            "command goes on"
        ) from None
    except distributed.CancelledError:
        raise ConnectionError(f"{address}: the Dask scheduler is gone; the same command goes on") from None
    finally:
        log.setLevel(level)


def _computed(client: Any, call: Call, tasks: Sequence[Task]) -> Finished:
    from distributed import as_completed

    if not client.scheduler_info()["workers"]:
        tqdm.write("the Dask scheduler has no workers yet; waiting for one", file=sys.stderr)
    futures = {client.submit(call, task, pure=False): task for task in tasks}
    try:
        for future in as_completed(list(futures), loop=client.loop):
            result = future.result()
            yield futures.pop(future), result
            future.release()  # else it would be computed again for nobody where its worker dies
    finally:
        client.cancel(list(futures), force=True)
