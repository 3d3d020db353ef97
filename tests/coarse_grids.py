"""Grids of the harmonic transport that take less time: values by the names of what they replace."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import pytest

from torchbrdf.transport.harmonic.light import TurningLight

HALF_GRID = {
    "torchbrdf.transport.harmonic.grid._ROWS": (128, 96, 64, 64),
    "torchbrdf.transport.harmonic._integrals._AZIMUTHS": (32, 48, 64, 96),
    "torchbrdf.brdf.norms._SAMPLES": 1 << 16,
    "torchbrdf.transport.harmonic.basis.TurningLight": lambda probe, _: TurningLight(probe, 360),
}
"""Of the harmonic transport: as good for TINY_MATERIALS under `LightProbe.default(64)`, in a third of the time."""

QUARTER_GRID = HALF_GRID | {
    "torchbrdf.transport.harmonic.grid._ROWS": (64, 48, 32, 32),
    "torchbrdf.transport.harmonic._integrals._AZIMUTHS": (16, 24, 32, 48),
}
"""Good enough to find a rotation to a tenth of a degree; perspective takes long to compute on a finer grid."""

COARSE = {
    "torchbrdf.brdf.library.MIN_MATERIALS": 1,
    "torchbrdf.transport.harmonic.grid._ROWS": (16, 12, 8, 8),
    "torchbrdf.transport.harmonic.grid.RINGS_PER_GROUP": 8,
    "torchbrdf.transport.harmonic._integrals._AZIMUTHS": (8, 8, 8, 8),
    "torchbrdf.brdf.norms._SAMPLES": 1 << 12,
}
"""Good for nothing but to see what is computed, and when."""


@contextmanager
def computed_on(grid: Mapping[str, Any]) -> Iterator[pytest.MonkeyPatch]:
    """With one of these grids in the place of the grid at work; what else is patched goes with it."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in grid.items():
            patch.setattr(name, value)
        yield patch
