"""A library of 500 materials is built within two minutes and 3 GB; one more costs seconds, not another build.

    python scripts/benchmarks/library_growth.py --folder SCRATCH
    python scripts/benchmarks/library_growth.py --folder SCRATCH --transport

The materials are random mixtures of the embedded library's columns, which no file holds: what is timed is the
conversion, the Gram matrix and the writing; with --transport also what is precomputed for basis images. Error: of the
Gram matrix of the library that grew, against the same one built anew, relative to the norms of the columns, where 2^-11
is what columns are rounded by; of basis images of a sphere, by the transport of the grown library against that of the
one before, relative to their root mean square. SCRATCH needs 14 GB while it runs.
"""

import argparse
import os
import resource
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf.brdf import ROW_CELLS, StoredColumns, above_horizon
from torchbrdf.brdf.column_sources import Extent
from torchbrdf.brdf.library_cache import open_or_build
from torchbrdf.transport.harmonic import transport_of


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

    def scan(self, material: int) -> Extent:
        """See ColumnSource."""
        peak = (self.library.stored.scale * 2.0**12) @ self.weights[:, 3 * material : 3 * material + 3].double()
        return Extent(peak, above_horizon().ravel())

    def row(self, i: int) -> Tensor:
        """See ColumnSource."""
        return self.library.rows(slice(i * ROW_CELLS, (i + 1) * ROW_CELLS)) @ self.weights

    def subset(self, materials: Sequence[int]) -> "Mixtures":
        """See ColumnSource."""
        return Mixtures(self.library, [self.materials[i] for i in materials])


def built(source: Mixtures, folder: Path, known: Sequence[StoredColumns] = ()) -> tuple[float, tb.MaterialLibrary]:
    """Seconds, and the library."""
    start = time.perf_counter()
    stored = open_or_build(source, folder, progress=False, known=known)
    return time.perf_counter() - start, tb.MaterialLibrary(stored, tuple(range(len(stored.names))))


def precomputed(library: tb.MaterialLibrary) -> float:
    """Seconds."""
    start = time.perf_counter()
    transport_of(library)
    return time.perf_counter() - start


def images(library: tb.MaterialLibrary) -> Tensor:
    """(n, P) of a sphere under the embedded probe."""
    return tb.render_basis(library, tb.LightProbe.default(), tb.SphereView(64), backend="harmonic").packed


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--materials", type=int, default=500)
    parser.add_argument("--transport", action="store_true", help="precompute it in the place of building anew")
    parser.add_argument("--folder", type=Path, help="where there is room; default: the system's")
    options = parser.parse_args()
    count = options.materials
    embedded = tb.MaterialLibrary.default()
    with tempfile.TemporaryDirectory(dir=options.folder) as name, torch.no_grad():
        os.environ["TORCHBRDF_CACHE"] = name
        libraries = Path(name) / "libraries"
        first, whole = built(Mixtures(embedded, range(count)), libraries / "whole")
        resident = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        one_more, grown = built(Mixtures(embedded, range(count + 1)), libraries / "grown", [whole.stored])
        print("| | seconds | largest difference |\n|---|---:|---:|")
        print(f"| {count} materials, built ({resident:.2f} GB resident) | {first:.1f} | |")
        if options.transport:
            print(f"| one more | {one_more:.1f} | |")
            print(f"| transport of {count} | {precomputed(whole):.1f} | |")
            seconds = precomputed(grown)
            one, both = images(whole), images(grown)[: whole.n]
            off = (both - one).square().mean(1).sqrt() / one.square().mean(1).sqrt()
            print(f"| transport with one more | {seconds:.1f} | {float(off.max()):.1e} |")
            return
        anew, expected = built(Mixtures(embedded, range(count + 1)), Path(name) / "elsewhere" / "anew")
        norms = expected.gram.diagonal().sqrt()
        change = (grown.gram - expected.gram).abs() / (norms[:, None] * norms)
        print(f"| one more | {one_more:.1f} | {float(change.max()):.1e} |")
        print(f"| {count + 1} materials, built anew | {anew:.1f} | |")


if __name__ == "__main__":
    main()
