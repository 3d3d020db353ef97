"""Balls are found in whole photographs to 0.15 pixel of 64: how often, how fast, and what is found that is none.

Run `python scripts/benchmarks/finding.py FOLDER...` with folders of scripts/make_captures.py, or `--composed N` for N
scenes of finding_scenes.py under the probes of ../shared/data. Deviations are the largest of the centre's two and the
radius's, in pixels of a ball 64 pixels across.
"""

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from finding_scenes import compose
from torchbrdf.camera import Ball, PinholeCamera
from torchbrdf.experiments import default_probes
from torchbrdf.images import read_image
from torchbrdf.photograph import find_balls

WANTED = 0.15
FAR = 0.5
FOV_DEG = 24.0
"""Of the captures' camera."""

NONE = float("inf")


@dataclass(frozen=True)
class Case:
    """A photograph, and the ball in it that is to be found, its largest."""

    name: str
    image: Tensor
    ball: Ball
    mirror: bool


def captured(folder: Path) -> Iterator[Case]:
    """The photographs and mirror balls of a folder of captures."""
    for truth in sorted(folder.glob("*/truth.json")):
        record = json.loads(truth.read_text())
        for file, key in (("photo", "ball"), ("chrome", "chrome"), ("chrome60", "chrome60")):
            path = truth.parent / f"{file}.exr"
            if key in record and path.is_file():
                image = read_image(path)
                height, width = image.shape[1:]
                camera = PinholeCamera.of_fov((height, width), FOV_DEG)
                x, y, z = record[key]["direction"]
                ball = Ball(camera, (x, y, z), record[key]["radius_deg"])
                yield Case(f"{truth.parent.name}/{file}", image, ball, key != "ball")


def composed(n: int) -> Iterator[Case]:
    """Scenes with one to three balls."""
    probes = [read_image(path) for path in default_probes()]
    for seed in range(n):
        scene = compose(probes[seed % len(probes)], seed)
        height, width = scene.image.shape[1:]
        camera = PinholeCamera.of_fov((height, width), scene.fov_deg)
        direction, radius_deg, mirror = max(scene.balls, key=lambda ball: ball[1])
        x, y, z = direction.tolist()
        yield Case(f"{seed} {scene.about}", scene.image, Ball(camera, (x, y, z), radius_deg), mirror)


def measured(case: Case) -> tuple[float, bool, float]:
    """Deviation of the ball found, whether it is sure, and the seconds it took."""
    start = time.process_time()
    found = find_balls(case.image, case.ball.camera)
    seconds = time.process_time() - start
    x, y, radius = case.ball.circle
    deviations = [
        (max(abs(one.circle.x - x), abs(one.circle.y - y), abs(one.circle.radius - radius)) / radius * 32, one)
        for one in found
    ]
    deviation, best = min(deviations, key=lambda pair: pair[0], default=(NONE, None))
    sure = best is not None and best.sure and best.round
    if deviation > WANTED or not sure:
        print(f"  {case.name}: {deviation:.2f}, {best or 'nothing'}{'' if sure else ', not sure'}", flush=True)
    return deviation, sure, seconds


def main() -> None:
    """Print a row for balls and one for mirrors of each set."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--composed", type=int, default=0, metavar="N")
    options = parser.parse_args()
    torch.set_num_threads(2)
    sets = {str(folder): captured(folder) for folder in options.folders}
    if options.composed:
        sets["composed"] = composed(options.composed)
    rows = []
    for name, cases in sets.items():
        results = [(case.mirror, *measured(case)) for case in cases]
        for kind, mirror in (("balls", False), ("mirrors", True)):
            chosen = np.array([result[1:] for result in results if result[0] == mirror], dtype=float)
            if len(chosen):
                deviation, sure, seconds = chosen.T
                far = int(((deviation > FAR) & (sure > 0)).sum())
                rows.append(
                    f"| {name}, {len(chosen)} {kind} | {(deviation < WANTED).mean():.0%} | {np.median(deviation):.3f} "
                    f"| {deviation.max():.2f} | {1 - sure.mean():.0%} | {far} | {np.median(seconds):.2f} |"
                )
    head = f"within {WANTED} | median | worst | said to be unsure | over {FAR} unsaid | CPU seconds"
    print(f"| | {head} |\n|---|---|---|---|---|---|---|")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
