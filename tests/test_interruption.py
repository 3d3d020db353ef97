"""Signals that end a program: when they are raised, when they wait, and what a command leaves behind."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from paths import ROOT
from torchbrdf.interruption import interruptible, uninterrupted

PATIENCE = 60
ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="this system has no such signals")


def handlers() -> list[Any]:
    return [signal.getsignal(number) for number in ENDING]


class TestHere:
    @pytest.mark.parametrize("number", ENDING)
    def test_a_signal_is_a_keyboard_interrupt(self, number: signal.Signals):
        before = handlers()
        with pytest.raises(KeyboardInterrupt), interruptible() as interruption:
            signal.raise_signal(number)
        assert interruption.received == number
        assert handlers() == before

    def test_what_another_handles_or_ignores_stays(self):
        def mine(*_: object) -> None:
            pass

        before = signal.signal(signal.SIGTERM, mine), signal.signal(signal.SIGHUP, signal.SIG_IGN)
        try:
            with interruptible():
                assert handlers()[1:] == [mine, signal.SIG_IGN]
            assert handlers()[1:] == [mine, signal.SIG_IGN]
        finally:
            signal.signal(signal.SIGTERM, before[0])
            signal.signal(signal.SIGHUP, before[1])

    def test_another_thread_changes_nothing(self):
        found = []

        def run() -> None:
            with interruptible(), uninterrupted():
                found.append(handlers())

        before = handlers()
        thread = threading.Thread(target=run)
        thread.start()
        thread.join()
        assert found == [before]

    def test_a_block_in_a_block_is_a_part_of_it(self):
        with interruptible() as outer:
            with interruptible() as inner:
                assert inner is outer
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGTERM)

    def test_it_waits_for_the_end_of_what_must_not_be_cut(self):
        done = []

        def run() -> None:
            with uninterrupted(), uninterrupted():
                signal.raise_signal(signal.SIGTERM)
                done.append("all of it")
            done.append("too much")

        with pytest.raises(KeyboardInterrupt), interruptible():
            run()
        assert done == ["all of it"]

    def test_a_second_one_does_not_disturb_the_clean_up(self):
        with interruptible():
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGINT)

    def test_one_that_was_lost_is_not_the_last(self, monkeypatch: pytest.MonkeyPatch):
        """What is raised in a destructor, say, reaches nobody."""
        with interruptible():
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGTERM)
            now = time.monotonic()
            monkeypatch.setattr("time.monotonic", lambda: now + 60)
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGTERM)


def ended(command: list[str], ready: Callable[[], Any], *numbers: signal.Signals) -> tuple[int, list[str]]:
    """The exit status and what is said, less progress bars, by a command that gets signals once it is at work."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        end = time.monotonic() + PATIENCE
        while not ready():
            assert process.poll() is None, process.communicate()[1]
            assert time.monotonic() < end, "nothing happened"
            time.sleep(0.02)
        for number in numbers:
            process.send_signal(number)
        said = process.communicate(timeout=PATIENCE)[1]
    finally:
        process.kill()
    return process.returncode, [line for line in said.splitlines() if line.strip() and "%|" not in line]


@pytest.fixture
def slow(tmp_path: Path, merl_directory: Path) -> tuple[Path, list[str]]:
    """A folder, and a render into it that would take minutes."""
    out = tmp_path / "out"
    out.mkdir()
    options = ["--probe", "default", "--size", "256", "--samples", "100000", "-o", str(out / "x.exr")]
    return out, [sys.executable, "-m", "torchbrdf.cli", "render", str(merl_directory / "white.binary"), *options]


class TestCommands:
    @pytest.mark.parametrize("number", ENDING)
    def test_nothing_is_left(self, slow: tuple[Path, list[str]], number: signal.Signals):
        out, command = slow
        status, lines = ended(command, lambda: os.listdir(out), number)
        named = "" if number == signal.SIGINT else f" ({number.name})"
        assert (status, lines) == (128 + number, [f"torchbrdf: interrupted; nothing was written{named}"])
        assert os.listdir(out) == []

    def test_two_at_once(self, slow: tuple[Path, list[str]]):
        out, command = slow
        status, lines = ended(command, lambda: os.listdir(out), signal.SIGTERM, signal.SIGTERM)
        assert (status, len(lines)) == (143, 1)
        assert os.listdir(out) == []

    def test_a_library_that_is_being_built(self, merl_directory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setenv("TORCHBRDF_CACHE", str(tmp_path / "cache"))
        command = [sys.executable, "-m", "torchbrdf.cli", "classes", "--library", str(merl_directory)]
        status, lines = ended(command, lambda: list(tmp_path.rglob("columns.f16")), signal.SIGTERM)
        assert (status, lines) == (143, ["torchbrdf: interrupted; nothing was written (SIGTERM)"])
        assert [path.suffix for path in tmp_path.rglob("*") if path.is_file()] == [".lock"]
