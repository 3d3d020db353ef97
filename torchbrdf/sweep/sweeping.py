"""Results of tasks, each kept in a file: those that are there are read, the others computed."""

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from tqdm import tqdm

from torchbrdf.files import writing
from torchbrdf.sweep.cluster import on_cluster
from torchbrdf.sweep.processes import in_processes
from torchbrdf.sweep.tasks import Call, Finished, Task


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
    Raises ValueError where two tasks share a name, or one is no name of a file, or the folder holds a result of other
    arguments, another function or another version; what the function raises; ChildProcessError where processes are
    killed; ConnectionError without a scheduler. After an error, or Ctrl-C, the same call goes on where it stopped.
    """
    names = [task.name for task in tasks]
    if len(set(names)) < len(names):
        raise ValueError(f"tasks must have different names; twice: {max(names, key=names.count)}")
    if processes < 1:
        raise ValueError(f"a sweep needs at least one process, got {processes}")
    for name in names:
        if not _is_name(name):
            raise ValueError(f"tasks are named as files, with no path separator, NUL or empty name; got {name!r}")
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
        return on_cluster(call, tasks, scheduler)
    if processes == 1:
        return ((task, call(task)) for task in tasks)
    return in_processes(call, tasks, min(processes, len(tasks)))


def _is_name(name: str) -> bool:
    """Whether NAME.json is a file of the folder itself, on every system."""
    return name != "" and not set(name) & set("/\\\0")


def _identity(call: Call, task: Task) -> dict[str, Any]:
    """What a result is of: the function, the version, and under a key of their own a hash of every argument."""
    texts = {key: json.dumps(value, sort_keys=True) for key, value in task.arguments.items()}
    hashes = {key: hashlib.sha256(text.encode()).hexdigest()[:16] for key, text in texts.items()}
    return {"function": f"{call.module}.{call.function}", "version": call.versions[0], "arguments": hashes}


def _differing(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    """The keys under which two say different things."""
    return [key for key in {**one, **other} if one.get(key) != other.get(key)]


def _stored(path: Path, identity: Mapping[str, Any]) -> dict[str, Any] | None:
    """A finished result; None where there is none, or a damaged file."""
    try:
        found: dict[str, Any] = json.loads(path.read_text())
        of = dict(found["of"])
    except (FileNotFoundError, ValueError, KeyError, TypeError):
        return None
    changed = _differing(identity, of)
    if changed:
        what, theirs = f"another {changed[0]}", of.get("arguments")
        if changed[0] == "arguments" and isinstance(theirs, dict):
            what = f"another {_differing(identity['arguments'], theirs)[0]}"
        elif changed[0] == "arguments":  # results of earlier versions hold the hashes beside the rest
            what = "other arguments"
        raise ValueError(f"{path} holds the result of {what}; choose another output folder")
    return found
