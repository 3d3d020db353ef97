"""Sweeps: what is kept, what is computed again, and the same bits in this process, in several and on a cluster."""

import functools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

from paths import ROOT
from sweep_tasks import (
    PATIENCE,
    dies_at_two,
    fails_at_two,
    interrupted_at_two,
    keywords,
    other_keywords,
    spectrum,
    tasks,
)
from torchbrdf.sweep import Task, sweep
from torchbrdf.sweep.processes import _children_ignore_interrupts
from torchbrdf.sweep.tasks import Call

HERE = str(ROOT / "tests")
"""Of `sweep_tasks`."""


def started(log: Path) -> list[tuple[int, int]]:
    """Seeds and processes of the tasks that were started."""
    if not log.exists():
        return []
    return [(int(seed), int(pid)) for seed, pid in map(str.split, log.read_text().splitlines())]


def wait_for(ready: Callable[[], Any]) -> Any:
    """What `ready` returns once that is true."""
    end = time.monotonic() + PATIENCE
    while not (found := ready()):
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.05)
    return found


def group(leader: int) -> list[int]:
    """The processes of a group that run; those that have ended and wait for their parents do not."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, its_group = (folder / "stat").read_text().rpartition(")")[2].split()[:3]
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(its_group) == leader and state != "Z":
            found.append(int(folder.name))
    return found


class TestKeeping:
    def test_results_by_name_and_a_file_each(self, tmp_path: Path) -> None:
        found = sweep(spectrum, tasks(tmp_path / "log"), tmp_path / "out")
        assert list(found) == ["seed-0", "seed-1", "seed-2", "seed-3"]
        assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [f"seed-{i}.json" for i in range(4)]
        matrix = torch.randn(200, 200, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
        expected = torch.linalg.eigvalsh(matrix @ matrix.T)
        torch.testing.assert_close(torch.tensor(found["seed-3"]["values"], dtype=torch.float64), expected)

    def test_finished_tasks_are_read_and_equal(self, tmp_path: Path) -> None:
        log = tmp_path / "log"
        first = sweep(spectrum, tasks(log), tmp_path / "out")
        (tmp_path / "out" / "seed-1.json").unlink()
        (tmp_path / "out" / "seed-2.json").write_text("{")
        second = sweep(spectrum, tasks(log, 5), tmp_path / "out")
        assert [seed for seed, _ in started(log)] == [0, 1, 2, 3, 1, 2, 4]
        assert {name: second[name] for name in first} == first
        assert first["seed-0"]["pair"] == [1, 0]

    def test_other_arguments_are_refused_and_other_places_are_not(self, tmp_path: Path) -> None:
        sweep(spectrum, tasks(tmp_path / "log"), tmp_path / "out")
        sweep(spectrum, tasks(tmp_path / "another log"), tmp_path / "out")
        assert not (tmp_path / "another log").exists()
        other = [Task("seed-0", {"seed": 7}, {"log": str(tmp_path / "log")})]
        message = "seed-0.json holds the result of another seed; choose another output folder$"
        with pytest.raises(ValueError, match=message):
            sweep(spectrum, other, tmp_path / "out")

    def test_another_function_or_version_is_refused(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        sweep(spectrum, tasks(tmp_path / "log"), tmp_path / "out")
        with pytest.raises(ValueError, match=r"seed-0.json holds the result of another function; choose"):
            sweep(fails_at_two, tasks(tmp_path / "log"), tmp_path / "out")
        monkeypatch.setattr("torchbrdf.sweep.tasks.__version__", "0.0.0")
        with pytest.raises(ValueError, match=r"seed-0.json holds the result of another version; choose"):
            sweep(spectrum, tasks(tmp_path / "log"), tmp_path / "out")

    def test_arguments_named_as_what_else_a_result_is_of(self, tmp_path: Path) -> None:
        arguments = {"function": 1, "version": 2, "arguments": 3}
        assert sweep(keywords, [Task("a", arguments)], tmp_path) == {"a": arguments}
        assert sweep(keywords, [Task("a", arguments)], tmp_path) == {"a": arguments}
        with pytest.raises(ValueError, match=r"a.json holds the result of another function; choose"):
            sweep(other_keywords, [Task("a", arguments)], tmp_path)
        for name in arguments:
            with pytest.raises(ValueError, match=rf"a.json holds the result of another {name}; choose"):
                sweep(keywords, [Task("a", {**arguments, name: 4})], tmp_path)

    @pytest.mark.parametrize("arguments", [{"x": 1}, {"arguments": 1}, {}])
    def test_results_of_earlier_releases_are_refused(self, arguments: dict[str, int], tmp_path: Path) -> None:
        """They held the hashes of arguments beside the function and the version."""
        sweep(keywords, [Task("a", arguments)], tmp_path)
        path = tmp_path / "a.json"
        stored = json.loads(path.read_text())
        stored["of"].update(stored["of"].pop("arguments"))
        path.write_text(json.dumps(stored))
        with pytest.raises(ValueError, match=r"a.json holds the result of other arguments; choose"):
            sweep(keywords, [Task("a", arguments)], tmp_path)

    def test_what_was_finished_before_an_error_stays(self, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match=r"^two is too much$"):
            sweep(fails_at_two, tasks(tmp_path / "log"), tmp_path)
        assert sorted(path.name for path in tmp_path.iterdir()) == ["seed-0.json", "seed-1.json"]

    def test_and_before_ctrl_c(self, tmp_path: Path) -> None:
        with pytest.raises(KeyboardInterrupt):
            sweep(interrupted_at_two, tasks(tmp_path / "log"), tmp_path)
        assert sorted(path.name for path in tmp_path.iterdir()) == ["seed-0.json", "seed-1.json"]


class TestBadInput:
    def test_names_twice(self, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match=r"^tasks must have different names; twice: seed-0$"):
            sweep(spectrum, tasks(tmp_path / "log", 1) * 2, tmp_path)

    @pytest.mark.parametrize("name", ["a/b", "a\\b", "/a", "../a", "", "a\0b"])
    def test_a_name_that_is_no_name_of_a_file(self, name: str, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match=r"^tasks are named as files, with no path separator, .* got '"):
            sweep(spectrum, [Task(name, {"seed": 0})], tmp_path / "out")
        assert not (tmp_path / "out").exists()

    def test_no_process(self, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match=r"^a sweep needs at least one process, got 0$"):
            sweep(spectrum, [], tmp_path, 0)

    def test_a_function_that_no_other_process_finds(self, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match=r"^a sweep needs a function of a module that can be imported, got "):
            sweep(lambda: 1, [], tmp_path)

    @pytest.mark.parametrize("function", [len, functools.partial(spectrum, seed=1), {}.get])
    def test_a_function_of_no_file(self, function: Callable[..., Any], tmp_path: Path) -> None:
        with pytest.raises(ValueError, match=r"^a sweep needs a function of a module that can be imported, got "):
            sweep(function, [], tmp_path)

    def test_another_version_on_a_worker(self) -> None:
        call = Call("sweep_tasks", "spectrum", HERE, ("0.0.0", torch.__version__))
        with pytest.raises(ValueError, match=r"^processes of a sweep must have the same torchbrdf and torch, got "):
            call(Task("", {}))

    def test_no_dask(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "distributed", None)
        message = r"^a scheduler needs dask.distributed: pip install 'torchbrdf\[cluster\]'$"
        with pytest.raises(ValueError, match=message):
            sweep(spectrum, tasks(tmp_path / "log"), tmp_path, scheduler="tcp://127.0.0.1:9")

    @pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nowhere at all"])
    def test_no_scheduler(self, address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        pytest.importorskip("distributed", reason="dask.distributed is not installed")
        monkeypatch.setattr("torchbrdf.sweep.cluster._CONNECT_SECONDS", 1)
        with pytest.raises(ConnectionError, match=f"^no Dask scheduler answers at {address} .*; start one with `dask "):
            sweep(spectrum, tasks(tmp_path / "log"), tmp_path, scheduler=address)


class TestProcesses:
    def test_the_same_bits_from_one_thread_each(self, tmp_path: Path) -> None:
        before = torch.get_num_threads()
        here = sweep(spectrum, tasks(tmp_path / "log"), tmp_path / "here")
        there = sweep(spectrum, tasks(tmp_path / "log"), tmp_path / "there", processes=2)
        assert here == there
        assert {result["threads"] for result in here.values()} == {1}
        assert torch.get_num_threads() == before
        assert os.getpid() not in {pid for _, pid in started(tmp_path / "log")[4:]}

    @pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="signals cannot be held back here")
    @pytest.mark.parametrize("receiver", ["this thread", "another thread"])
    def test_ctrl_c_while_processes_start_is_not_lost(self, receiver: str) -> None:
        """The system gives it to any thread that does not block it, such as those of torch."""
        done = []
        ended = threading.Event()
        other = threading.Thread(target=ended.wait)
        other.start()
        receivers = {"this thread": threading.get_ident(), "another thread": other.ident or 0}

        def started_meanwhile() -> None:
            with _children_ignore_interrupts():
                signal.pthread_kill(receivers[receiver], signal.SIGINT)
                time.sleep(0.01)  # another thread may take a moment
                done.append("all of them")

        try:
            with pytest.raises(KeyboardInterrupt):
                started_meanwhile()
        finally:
            ended.set()
            other.join()
        assert done == ["all of them"]

    def test_a_killed_process_is_told(self, tmp_path: Path) -> None:
        with pytest.raises(ChildProcessError, match=r"^a process of the sweep was killed, perhaps for want of memory"):
            sweep(dies_at_two, tasks(tmp_path / "log"), tmp_path, processes=2)

    @pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
    @pytest.mark.parametrize("when", ["Ctrl-C while they start", "Ctrl-C at work", "killed"])
    def test_no_process_survives_the_first(self, when: str, tmp_path: Path) -> None:
        """Ctrl-C reaches all processes of a terminal, SIGKILL only the first; tasks last longer than this test."""
        program, log = tmp_path / "program.py", tmp_path / "log"
        program.write_text(
            f"import sys; sys.path.insert(0, {HERE!r}); import sweep_tasks as t; from torchbrdf.sweep import sweep\n"
            "if __name__ == '__main__':\n"
            f"    some = t.tasks({str(log)!r}, seconds={2 * PATIENCE})\n"
            f"    sweep(t.spectrum, some, {str(tmp_path / 'out')!r}, processes=2)\n"
        )
        process = subprocess.Popen(
            [sys.executable, str(program)], stderr=subprocess.PIPE, text=True, start_new_session=True, cwd=ROOT
        )
        if when == "Ctrl-C while they start":
            wait_for(lambda: len(group(process.pid)) == 4)  # two at work, and Python's own beside the first
        else:
            wait_for(lambda: len(started(log)) == 2)
        if when == "killed":
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGINT)
        said = process.communicate(timeout=PATIENCE)[1]
        wait_for(lambda: not group(process.pid))
        assert said.count("Traceback") == said.count("\nKeyboardInterrupt") == (when != "killed")  # of the first alone

    @pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
    @pytest.mark.parametrize("receiver", ["the first alone", "all of them"])
    def test_sigterm_ends_all_of_them_and_leaves_nothing(self, receiver: str, tmp_path: Path) -> None:
        program, files, out = tmp_path / "program.py", tmp_path / "files", tmp_path / "out"
        files.mkdir()
        program.write_text(
            f"import sys; sys.path.insert(0, {HERE!r}); import sweep_tasks as t; from torchbrdf.sweep import sweep\n"
            "from torchbrdf.command_line import RESUMABLE, exit_status\n"
            "def run(_): sweep(t.writes_for_ever, "
            f"t.tasks({str(files)!r}), {str(out)!r}, processes=2)\n"
            "if __name__ == '__main__': sys.exit(exit_status('program', run, None, RESUMABLE))\n"
        )
        process = subprocess.Popen(
            [sys.executable, str(program)], stderr=subprocess.PIPE, text=True, start_new_session=True, cwd=ROOT
        )
        wait_for(lambda: len(list(files.iterdir())) == 2)
        if receiver == "all of them":
            os.killpg(process.pid, signal.SIGTERM)
        else:
            process.terminate()
        said = process.communicate(timeout=PATIENCE)[1].splitlines()
        assert process.returncode == 143
        assert [line for line in said if line.strip() and "%|" not in line] == [
            "program: interrupted; the same command goes on where it stopped (SIGTERM)"
        ]
        wait_for(lambda: not group(process.pid))
        assert list(files.iterdir()) == []
        assert list(out.iterdir()) == []


@pytest.fixture(scope="class")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a scheduler with two workers on loopback, each a process that knows nothing of this folder."""
    pytest.importorskip("distributed", reason="dask.distributed is not installed")
    folder = tmp_path_factory.mktemp("cluster")
    address = folder / "scheduler.json"
    common = ["--no-dashboard", "--scheduler-file", str(address)]
    commands = [["dask_scheduler", "--host", "127.0.0.1", "--port", "0", *common]]
    commands += [["dask_worker", "--nthreads", "1", "--no-nanny", "--local-directory", str(folder), *common]] * 2
    with open(folder / "log", "w") as log:
        processes = [
            subprocess.Popen([sys.executable, "-m", f"distributed.cli.{name}", *options], stderr=log, cwd=folder)
            for name, *options in commands
        ]
    try:
        wait_for(address.exists)
        yield json.loads(wait_for(address.read_text))["address"]
    finally:
        for process in reversed(processes):
            process.kill()
        for process in processes:
            process.wait()


class TestCluster:
    def test_an_error_of_a_task_is_the_error_of_the_sweep(self, cluster: str, tmp_path: Path) -> None:
        with pytest.raises(ValueError, match=r"^two is too much$"):
            sweep(fails_at_two, tasks(tmp_path / "log"), tmp_path / "out", scheduler=cluster)

    def test_a_killed_worker_loses_nothing(self, cluster: str, tmp_path: Path) -> None:
        """It dies in the middle of a task, which the other begins again."""
        log, stuck, out = tmp_path / "log", tmp_path / "stuck", tmp_path / "there"
        wanted = sweep(spectrum, tasks(tmp_path / "log here", 12), tmp_path / "here")

        def kill() -> None:
            os.kill(int(wait_for(lambda: stuck.exists() and stuck.read_text())), signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        found = sweep(spectrum, tasks(log, 12, stuck=str(stuck)), out, scheduler=cluster)
        killer.join()
        assert found == wanted
        begun = [pid for seed, pid in started(log) if seed == 5]
        assert len(begun) == 2
        assert begun[0] == int(stuck.read_text()) != begun[1]
        assert {seed for seed, _ in started(log)} == set(range(12))

        count = len(started(log))
        again = sweep(spectrum, tasks(log, 13), out, scheduler=cluster)
        assert {name: again[name] for name in wanted} == wanted
        assert [seed for seed, _ in started(log)[count:]] == [12]
