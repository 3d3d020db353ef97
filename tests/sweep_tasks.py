"""Tasks of sweeps: functions that other processes import, by this module alone."""

import os
import signal
import time
from pathlib import Path
from typing import Any

import torch

from torchbrdf.files import writing
from torchbrdf.sweep import Task

PATIENCE = 120
"""Seconds after which a test that waits for other processes gives up; they need a few."""


def spectrum(seed: int, log: str, seconds: float = 0, stuck: str | None = None) -> dict[str, Any]:
    """Numbers that show in which order sums were done; says when it starts, and in which process.

    stuck  the file that tells who was the first to compute seed 5: it never ends
    """
    with open(log, "a") as file:
        file.write(f"{seed} {os.getpid()}\n")
    if seed == 5 and stuck is not None and not Path(stuck).exists():
        Path(stuck).write_text(str(os.getpid()))
        seconds = 2 * PATIENCE
    time.sleep(seconds)
    matrix = torch.randn(200, 200, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    values, vectors = torch.linalg.eigh(matrix @ matrix.T)
    numbers = {"values": values.tolist(), "sum": float(vectors.sum()), "pair": (1, seed)}
    return {"threads": torch.get_num_threads(), **numbers}


def writes_for_ever(seed: int, log: str) -> None:
    """A task that ends in the middle of a file."""
    with writing(Path(log) / f"{seed}") as temporary:
        temporary.write_text("half")
        time.sleep(2 * PATIENCE)


def fails_at_two(seed: int, log: str) -> int:
    """A task that raises."""
    if seed == 2:
        raise ValueError("two is too much")
    return seed


def dies_at_two(seed: int, log: str) -> int:
    """A task whose process is killed."""
    if seed == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return seed


def interrupted_at_two(seed: int, log: str) -> int:
    """A task during which Ctrl-C is pressed."""
    if seed == 2:
        raise KeyboardInterrupt
    return seed


def tasks(log: Path, count: int = 4, **more: Any) -> list[Task]:
    places = {"log": str(log), **more}
    return [Task(f"seed-{seed}", {"seed": seed}, places) for seed in range(count)]


def keywords(**given: Any) -> dict[str, Any]:
    """Its own arguments."""
    return given


def other_keywords(**given: Any) -> dict[str, Any]:
    """None of them."""
    return {}
