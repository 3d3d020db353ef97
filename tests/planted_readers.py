"""Readers that misbehave on purpose, for tests of `fuzz_readers.py`; all of them read what has no 'bad' in it."""

import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random

import numpy as np

import torchbrdf.light.probe
from fuzzing.files import InputFile
from fuzzing.readers import Reader

SEEDS = [InputFile("sound", ".txt", b"sound")]
kept: list[bytearray] = []


def seeds() -> list[InputFile]:
    return SEEDS


def mutated(seed: InputFile, rng: Random, others: Sequence[InputFile]) -> InputFile:
    return seed.with_content(b"bad" if rng.random() < 0.4 else b"good")


def aborts(path: Path) -> None:
    os.abort()


def leaves(path: Path) -> None:
    os._exit(0)


def hangs(path: Path) -> None:
    time.sleep(60)


def allocates(path: Path) -> None:
    np.empty(4 << 30, np.uint8)  # never touched: resident memory would not tell


def allocates_and_says_so(path: Path) -> None:
    bytearray(300 << 20)
    raise ValueError(f"{path}: too large")


def loads_once(path: Path) -> None:
    if not kept:
        kept.append(bytearray(400 << 20))


def is_modest(path: Path) -> None:
    bytearray(30 << 20)


def raises(path: Path) -> None:
    raise TypeError("no")


def exits(path: Path) -> None:
    raise SystemExit(3)


def names_no_file(path: Path) -> None:
    raise ValueError("no")


def says_two_lines(path: Path) -> None:
    raise ValueError(f"{path}: no\nat all")


def colours_the_terminal(path: Path) -> None:
    raise ValueError(f"{path}: \x1b[31mno")


def refuses(path: Path) -> None:
    raise ValueError(f"{path}: no")


def does_not_find(path: Path) -> None:
    Path(f"{path}.gone").read_bytes()


def says_which_package(path: Path) -> None:
    raise TypeError(torchbrdf.light.probe.__file__)


def _reader(planted: Callable[[Path], None], **constants: int) -> Reader:
    def opened(path: Path) -> None:
        if b"bad" in path.read_bytes():
            planted(path)

    return Reader(planted.__name__, seeds, mutated, {"open": (opened, 1.0)}, constants)


READERS = {
    planted.__name__: _reader(planted)
    for planted in (
        aborts, leaves, hangs, allocates, allocates_and_says_so, loads_once, is_modest, raises, exits, names_no_file,
        says_two_lines, colours_the_terminal, refuses, does_not_find, says_which_package,
    )
}  # fmt: skip
READERS["is_modest_with_less"] = _reader(is_modest, open=8 << 20)
