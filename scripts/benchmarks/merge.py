#!/usr/bin/env python3
"""Claim: merged radiance is within 1 % where a bracket holds it well, with OpenCV's Debevec and Robertson behind.

    python scripts/benchmarks/merge.py --probes ../shared/data/probes/{grace,uffizi,ennis}.hdr

Brackets are simulated from light probes: photons and reading noise, a camera's curve, 8 bits, JPEG of quality 95. The
known curve is given to all methods; the other one is estimated by each. Handheld frames are shifted by up to 12 pixels;
before OpenCV's methods `AlignMTB` lays them over one another.

Each cell is the median relative error of the pixels of one decade of the linear value in the middle exposure, that
median over probes, after one factor for each channel. Pixels count that the shortest exposure holds below 0.8 of
clipping with all around them, in the frame that a method laid the others over. Beside it CPU seconds a bracket.
"""

import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from merge_cases import CURVES, Camera, bracket, moved
from torchbrdf.brackets import Response, merge
from torchbrdf.command_line import Parser
from torchbrdf.experiments import markdown_table
from torchbrdf.images import read_image

SIZE = (600, 400)
BRACKETS = {"4 exposures, 2 stops apart": (4, 4.0), "7, 1 stop": (7, 2.0)}
MIDDLE = 0.15
"""Linear value of the median radiance in the middle exposure."""
DECADES = (-3, -2, -1, 0, 1)
SHIFT = 12.0
UNCLIPPED = 0.8
Method = Callable[[Sequence[Path], Sequence[float], str, bool], np.ndarray]


def scene(path: Path) -> np.ndarray:
    """(H, W, 3) of a probe, median 1."""
    radiance = read_image(path).permute(1, 2, 0).numpy().clip(1e-4)
    resized = np.asarray(cv2.resize(radiance, SIZE, interpolation=cv2.INTER_CUBIC)).clip(1e-4)
    return np.asarray(resized / np.median(resized), dtype=np.float32)


def ours(files: Sequence[Path], times: Sequence[float], curve: str, still: bool) -> np.ndarray:
    response: Response = "srgb" if curve == "srgb" else "estimate"
    merged = merge(files, times, response=response, still=still)
    return merged.image.permute(1, 2, 0).numpy()


def opencv(calibrate: str, merger: str) -> Method:
    """One of OpenCV's methods."""

    def run(files: Sequence[Path], times: Sequence[float], curve: str, still: bool) -> np.ndarray:
        images = [np.asarray(cv2.imread(str(file))) for file in files]
        if not still:
            cv2.createAlignMTB().process(images, images)
        exposures = np.array(times, dtype=np.float32)
        if curve == "srgb":
            codes = np.arange(256) / 255
            linear = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
            response = np.repeat(np.maximum(linear, 1e-6).astype(np.float32)[:, None, None], 3, axis=2)
        else:
            response = getattr(cv2, f"createCalibrate{calibrate}")().process(images, exposures)
        found = getattr(cv2, f"createMerge{merger}")().process(images, exposures, response)
        return np.asarray(found)[..., ::-1]

    return run


METHODS: dict[str, Method] = {
    "torchbrdf": ours,
    "OpenCV, Debevec": opencv("Debevec", "Debevec"),
    "OpenCV, Robertson": opencv("Robertson", "Robertson"),
}


def errors(found: np.ndarray, truth: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Relative, NaN where not held, after the best factor for each channel."""
    with np.errstate(all="ignore"):
        ratio = np.where(held, found / truth, np.nan)
    ratio[~np.isfinite(ratio)] = np.nan
    middle = np.nanmedian(np.where((truth > 0.1) & (truth < 10), ratio, np.nan), axis=(0, 1))
    return np.abs(ratio / middle - 1)


def rows(probes: Sequence[Path]) -> Iterator[list[str]]:
    for curve in ("srgb", "s-shaped"):
        for name, (count, factor) in BRACKETS.items():
            for still in (True, False):
                results: dict[str, list[list[float]]] = {method: [] for method in METHODS}
                for seed, probe in enumerate(probes):
                    for method, row in case(scene(probe), curve, count, factor, still, seed).items():
                        results[method].append(row)
                for method, found in results.items():
                    cells = [statistics.median(column) for column in zip(*found, strict=True)]
                    held = "tripod" if still else "handheld"
                    known = "known" if curve == "srgb" else "estimated"
                    errors_of = [f"{100 * cell:.1f}" if np.isfinite(cell) else "" for cell in cells[:-1]]
                    print(known, name, held, method, errors_of, file=sys.stderr, flush=True)
                    yield [f"{known}; {name}; {held}", method, *errors_of, f"{cells[-1]:.2f}"]


def case(radiance: np.ndarray, curve: str, count: int, factor: float, still: bool, seed: int) -> dict[str, list[float]]:
    """Of each method the errors by decade, and its CPU seconds."""
    times = [MIDDLE * factor ** (k - (count - 1) / 2) for k in range(count)]
    random = np.random.default_rng(seed)
    motions = [tuple(random.uniform(-SHIFT, SHIFT, 2)) for _ in times]
    middle = count // 2
    motions[middle] = (0.0, 0.0)
    assert curve in CURVES
    with tempfile.TemporaryDirectory() as folder:
        files = bracket(Path(folder), radiance, times, Camera(curve), None if still else motions, seed)
        found, seconds = {}, {}
        for name, method in METHODS.items():
            start = time.process_time()
            found[name] = method(files, times, curve, still)
            seconds[name] = time.process_time() - start
    table = {}
    for name, one in found.items():
        truth = radiance if still else placed(radiance, one, motions)
        held = cv2.erode((truth.max(axis=2) * times[0] < UNCLIPPED).astype(np.uint8), np.ones((5, 5))) > 0
        apart = errors(one, truth, held[..., None])
        level = np.where(held[..., None], np.floor(np.log10(truth * times[middle])), np.nan)
        table[name] = [float(np.nanmedian(apart[level == decade])) for decade in DECADES] + [seconds[name]]
    return table


def placed(radiance: np.ndarray, found: np.ndarray, motions: Sequence[tuple[float, ...]]) -> np.ndarray:
    """The truth as the frame sees it that a method laid the others over: that which agrees best."""
    candidates = [moved(radiance, *motion) if any(motion) else radiance for motion in motions]
    with np.errstate(all="ignore"):
        logs = [np.abs(np.log(found[8:-8, 8:-8] / one[8:-8, 8:-8])) for one in candidates]
    return candidates[int(np.argmin([np.nanmedian(np.abs(log - np.nanmedian(log))) for log in logs]))]


def main() -> None:
    parser = Parser.of_script(__doc__)
    parser.add_argument("--probes", type=Path, nargs="+", required=True, help="light probes, whose radiance is taken")
    warnings.simplefilter("ignore")
    decades = [f"1e{decade} to 1e{decade + 1}, %" for decade in DECADES]
    print(markdown_table(["bracket", "method", *decades, "CPU, s"], list(rows(parser.parse_args().probes))))


if __name__ == "__main__":
    main()
