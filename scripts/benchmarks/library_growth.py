"""A library of 500 materials is built within two minutes and 3 GB; one more costs seconds, not another build.

The materials are random mixtures of the embedded library's columns, which no file holds: what is timed is the
conversion, the Gram matrix and the writing. Error: the largest relative difference of the Gram matrices of the grown
and the built library.
"""

import argparse
import resource
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf.brdf import ROW_CELLS, StoredColumns, above_horizon
from torchbrdf.brdf.library_cache import open_or_build


class Mixtures:
    """Materials that are mixtures of four of the embedded ones."""

    def __init__(self, library: tb.MaterialLibrary, materials: Sequence[int]) -> None:
        """By number, which seeds each."""
        self.library, self.materials = library, list(materials)
        self.names = tuple(f"mixture {i}" for i in materials)
        self.stamps = self.names
        self.stamp = repr(self.names)
        self.weights = torch.zeros(library.n, 3 * len(self.materials))
        for column, i in enumerate(self.materials):
            generator = torch.Generator().manual_seed(i)
            for source in torch.randperm(len(library), generator=generator)[:4].tolist():
                share = torch.rand(1, generator=generator).item()
                for channel in range(3):
                    self.weights[3 * source + channel, 3 * column + channel] = share

    def scan(self, material: int) -> tuple[Tensor, Tensor]:
        """See ColumnSource."""
        peak = (self.library.stored.scale * 2.0**12) @ self.weights[:, 3 * material : 3 * material + 3].double()
        return peak, above_horizon().ravel()

    def row(self, i: int) -> Tensor:
        """See ColumnSource."""
        return self.library.rows(slice(i * ROW_CELLS, (i + 1) * ROW_CELLS)) @ self.weights

    def subset(self, materials: Sequence[int]) -> "Mixtures":
        """See ColumnSource."""
        return Mixtures(self.library, [self.materials[i] for i in materials])


def timed(source: Mixtures, folder: Path, known: Sequence[StoredColumns] = ()) -> tuple[float, StoredColumns]:
    """Seconds, and what was built."""
    start = time.perf_counter()
    stored = open_or_build(source, folder, progress=False, known=known)
    return time.perf_counter() - start, stored


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--materials", type=int, default=500)
    count = parser.parse_args().materials
    library = tb.MaterialLibrary.default()
    with tempfile.TemporaryDirectory() as folder:
        built, whole = timed(Mixtures(library, range(count)), Path(folder) / "whole")
        resident = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        grown, larger = timed(Mixtures(library, range(count + 1)), Path(folder) / "larger", [whole])
        norms = larger.gram.diagonal().sqrt()
        n = 3 * count
        change = (larger.gram[:n, :n] - whole.gram).abs() / (norms[:n, None] * norms[:n])
        print("| materials | seconds | seconds, one more | most resident, GB | Gram matrix, relative |")
        print("|---|---|---|---|---|")
        print(f"| {count} | {built:.1f} | {grown:.1f} | {resident:.2f} | {float(change.max()):.1e} |")


if __name__ == "__main__":
    main()
