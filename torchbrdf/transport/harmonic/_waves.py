"""Fourier series over azimuth of what is spread on nodes by splines."""

from functools import lru_cache
from math import pi

import torch
from torch import Tensor

from torchbrdf.lasting import lasting
from torchbrdf.transport.harmonic.grid import Zone
from torchbrdf.transport.harmonic.splines import SUPPORT

PLACES = 4
"""Nodes around the circle for each row of a zone."""


@lru_cache(maxsize=512)
@lasting
def waves(zone: Zone, line: int, frequencies: int | None = None) -> tuple[Tensor, Tensor]:
    """(M, line) each: cosines and sines at nodes, of which the first lies one place before delta = 0.

    frequencies  M, by default all of the zone
    A spline's own transform is a power of a sinc, by which they are divided.
    """
    places = PLACES * zone.rows
    frequency = torch.arange(zone.frequencies if frequencies is None else frequencies, dtype=torch.float64)[:, None]
    angle = frequency * ((torch.arange(line, dtype=torch.float32) - 1) * (2 * pi / places))
    spread = torch.sinc(frequency / places) ** SUPPORT
    return (torch.cos(angle) / spread).float(), (torch.sin(angle) / spread).float()
