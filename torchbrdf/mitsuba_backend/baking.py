"""Basis images rendered by Mitsuba: paths shared by all basis BRDFs [CBP21, eq. 5].

The paths of a pixel are traced once and their cells gathered from all columns of B. Samples come in passes, each
with random numbers of its own: their spread tells the error of every image, and a pass is what a run that was
interrupted has lost at most.
"""

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from torchbrdf.arguments import whole
from torchbrdf.brdf import MaterialLibrary
from torchbrdf.files import writing
from torchbrdf.light import LightProbe
from torchbrdf.mitsuba_backend._light_paths import N_NUMBERS, LightPaths
from torchbrdf.progress import progress_bar
from torchbrdf.transport import DEFAULT_SAMPLES, BasisImages, TransportSamples, gather_columns
from torchbrdf.view import View

_PATHS_AT_ONCE = 1 << 18
_PIXELS_AT_ONCE = 1 << 11
_PASSES = 8
"""At least, where there are so many samples: fewer tell their spread badly."""

_LARGEST_PASS = 256
_SAVE_EVERY = 10.0
"""Seconds between two writings of the state, or twenty times what the last one took."""

_FORMAT = "torchbrdf unfinished basis images 1"


@dataclass
class BakedSum:
    """Mean of the passes so far, and their spread [Wel62].

    mean    (3, P, n)  float32, in the units of the library's stored columns
    spread  (n,)       float64: sum over the passes of samples |y_k - mean|^2
    samples            a pixel so far
    passes             so far
    """

    mean: Tensor
    spread: Tensor
    samples: int = 0
    passes: int = 0

    @classmethod
    def empty(cls, n_pixels: int, n: int) -> "BakedSum":
        """Before the first pass."""
        return cls(torch.zeros(3, n_pixels, n, dtype=torch.float32), torch.zeros(n, dtype=torch.float64))

    def add(self, images: Tensor, samples: int) -> None:
        """One more pass: images (3, P, n), overwritten."""
        self.samples += samples
        self.passes += 1
        difference = images.sub_(self.mean)
        share = samples / self.samples
        self.spread += samples * (1 - share) * _energy(difference)
        self.mean.add_(difference, alpha=share)

    @property
    def relative_errors(self) -> Tensor:
        """(n,) float32: standard error of each image of the mean, relative to its norm; 0 for an image that is 0."""
        energy = _energy(self.mean)
        variance = self.spread / max(self.passes - 1, 1) / self.samples
        return torch.where(energy > 0, variance / energy, 0).sqrt().float()

    def save(self, path: Path, identity: str) -> None:
        """Write the state with what it is the state of."""
        counts = torch.tensor([self.samples, self.passes])
        with writing(path) as temporary:
            tensors = {"mean": self.mean, "spread": self.spread, "counts": counts}
            save_file(tensors, temporary, {"format": _FORMAT, "identity": identity})

    @classmethod
    def load(cls, path: Path, identity: str, shape: tuple[int, ...]) -> "BakedSum":
        """Read what `save` wrote; ValueError where it is something else or the state of something else."""
        try:
            with safe_open(path, "pt") as file:
                metadata = file.metadata() or {}
                tensors = {key: file.get_tensor(key) for key in list(file.keys())}
        except SafetensorError:
            raise ValueError(f"{path}: not the state of a bake (truncated, damaged); delete it to start anew") from None
        if metadata.get("format") != _FORMAT or metadata.get("identity") != identity:
            raise ValueError(
                f"{path}: the state of another bake (other probe, view, library, samples or seed); "
                "finish that one, or delete the file to start anew"
            )
        expected = {"mean": (torch.float32, shape), "spread": (torch.float64, shape[2:]), "counts": (torch.int64, (2,))}
        kinds = {key: (tensor.dtype, tuple(tensor.shape)) for key, tensor in tensors.items()}
        damaged = ValueError(f"{path}: damaged, not what an interrupted bake leaves; delete it to start anew")
        finite = all(bool(torch.isfinite(tensor).all()) for tensor in tensors.values())
        if kinds != expected or not finite or not 1 <= tensors["counts"][1] <= tensors["counts"][0]:
            raise damaged
        samples, passes = tensors["counts"].tolist()
        loaded = cls(tensors["mean"], tensors["spread"], samples, passes)
        if not bool(torch.isfinite(loaded.relative_errors).all()):  # of a spread below 0
            raise damaged
        return loaded


def _energy(images: Tensor) -> Tensor:
    """(n,) float64: sums of the squares of images (3, P, n)."""
    return (
        torch.stack([torch.linalg.vector_norm(channel, dim=0, dtype=torch.float64) for channel in images])
        .square()
        .sum(0)
    )


def bake_basis(
    library: MaterialLibrary,
    probe: LightProbe,
    view: View,
    samples: int = DEFAULT_SAMPLES,
    seed: int = 0,
    progress: bool = False,
    state: str | os.PathLike[str] | None = None,
) -> BasisImages:
    """Images Y of every basis BRDF, with light and densities from Mitsuba, and an error estimate for each image.

    samples  a pixel, at least 2; each takes one direction from the light and one from the BSDF
    state    file that keeps the passes done, every few seconds and when interrupted; if it exists, the bake goes
             on where that one stopped. The caller deletes it when the result is safe
    Memory is up to three times the result's, plus a constant. Raises ValueError for fewer than 2 samples or the
    state of another bake, MitsubaUnavailableError where Mitsuba cannot be loaded.
    """
    samples = whole("samples", samples)
    if samples < 2:
        raise ValueError(f"baking needs at least 2 samples a pixel, whose spread tells the error; got {samples}")
    columns, scale = library.stored.columns.cpu(), library.stored.scale
    library.stored.prefetch()
    identity = f"{library.source} {probe.fingerprint} {view.fingerprint} {samples} {seed}"
    path = None if state is None else Path(state)
    done = BakedSum.empty(len(view.pixels), columns.shape[1])
    if path is not None and path.exists():
        done = BakedSum.load(path, identity, tuple(done.mean.shape))
    paths = LightPaths(view, probe)
    size = max(1, min(_LARGEST_PASS, samples // _PASSES))
    saved, cost = time.monotonic(), 0.0
    measure: dict[str, Any] = {"total": samples, "initial": done.samples, "unit": "sample"}
    with progress_bar(desc="baking", shown=progress, leave=True, **measure) as bar:
        try:
            while done.samples < samples:
                count = min(size, samples - done.samples)
                done.add(_render_pass(paths, columns, count, (seed << 20) + done.passes), count)
                bar.update(count)
                if path is not None and time.monotonic() - saved > max(_SAVE_EVERY, 20 * cost):
                    cost = _save(done, path, identity)
                    saved = time.monotonic()
        finally:
            if path is not None and done.passes:
                _save(done, path, identity)
    errors = done.relative_errors
    images = done.mean.mul_(scale.float()).permute(2, 0, 1)
    return BasisImages.of(
        packed=images[library.column_index].contiguous(),
        library=library,
        probe=probe,
        view=view,
        description=f"mitsuba, {samples} samples a pixel, seed {seed}",
        relative_errors=errors[library.column_index],
    )


def _save(done: BakedSum, path: Path, identity: str) -> float:
    """Write the state; returns the seconds that took."""
    start = time.monotonic()
    done.save(path, identity)
    return time.monotonic() - start


def _render_pass(paths: LightPaths, columns: Tensor, samples: int, seed: int) -> Tensor:
    """(3, P, n): one pass over all pixels, in the units of the columns.

    Every pixel shifts the same scrambled Sobol' points by random offsets of its own [CP76].
    """
    generator = torch.Generator().manual_seed(seed)
    scramble = int(torch.randint(2**31, (1,), generator=generator))
    points = torch.quasirandom.SobolEngine(N_NUMBERS, scramble=True, seed=scramble).draw(samples).T[:, None]
    pixels = paths.view.pixels
    images = torch.empty(3, len(pixels), columns.shape[1], dtype=torch.float32)
    for chosen in torch.arange(len(pixels)).split(min(_PIXELS_AT_ONCE, _PATHS_AT_ONCE // samples)):
        shifts = torch.rand(N_NUMBERS, len(chosen), 1, generator=generator, dtype=torch.float32)
        numbers = (points + shifts).remainder_(1).clamp_(max=1 - 2.0**-24)
        found = paths.trace(pixels[chosen], numbers)
        images[:, chosen] = gather_columns(_by_weight(found), columns) / samples
    return images


def _by_weight(found: TransportSamples) -> TransportSamples:
    """The samples of each pixel in an order of like weights, as `gather_columns` wants them."""
    order = found.weights.sum(0).argsort(1)
    return TransportSamples(found.cells.gather(1, order), found.weights.gather(2, order.expand(3, -1, -1)))
