"""Decoders that print, beside threads that print."""

import os
import subprocess
import sys
import threading

import pytest

from torchbrdf.images.formats._quiet import quiet_decoders


def test_what_a_decoder_prints_is_dropped(capfd: pytest.CaptureFixture[str]) -> None:
    with quiet_decoders():
        os.write(2, b"from C\n")
        print("from Python")
        print("from Python", file=sys.stderr)
    print("after", file=sys.stderr)
    assert capfd.readouterr() == ("", "after\n")


def test_what_another_thread_prints_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    with quiet_decoders():
        another = threading.Thread(target=lambda: (print("one"), print("two", file=sys.stderr)))
        another.start()
        another.join()
    assert capfd.readouterr() == ("one\n", "two\n")


def test_a_stream_that_was_kept_prints_after_the_block(capfd: pytest.CaptureFixture[str]) -> None:
    with quiet_decoders():
        kept = sys.stderr
    print("late", file=kept)
    assert capfd.readouterr().err == "late\n"


def test_threads_that_decode_at_once_leave_the_streams_as_they_were() -> None:
    """The first ends while the second decodes, in a process of their own whose `sys.stderr` is descriptor 2."""
    program = """
import os, sys, threading, time
from torchbrdf.images.formats._quiet import quiet_decoders
begun = threading.Event()
def first():
    with quiet_decoders():
        begun.set()
        time.sleep(0.02)
def second():
    begun.wait()
    with quiet_decoders():
        time.sleep(0.06)
before = sys.stderr
threads = [threading.Thread(target=first), threading.Thread(target=second)]
[one.start() for one in threads]
[one.join() for one in threads]
os.write(1, b"same" if sys.stderr is before else b"lost")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True)
    assert done.stdout == b"same"
