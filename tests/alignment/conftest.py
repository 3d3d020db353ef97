"""The harmonic transport that is good enough to find rotations."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from coarse_grids import QUARTER_GRID, computed_on
from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.transport.harmonic.cache import transport_of


@pytest.fixture(scope="module")
def quarter_grid() -> Iterator[None]:
    """QUARTER_GRID in the place of the grid at work."""
    with computed_on(QUARTER_GRID):
        yield


@pytest.fixture(scope="module")
def quarter_library(own_cache: Path, precomputed_directory: Path, quarter_grid: None) -> MaterialLibrary:
    """`precomputed_library` on QUARTER_GRID: for modules that use no other."""
    library = MaterialLibrary.from_merl(precomputed_directory, progress=False)
    transport_of(library)
    return library
