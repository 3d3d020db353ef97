"""Light probes out of focus: diffusion over the sphere."""

from math import pi

import numpy as np
import torch
from torch import Tensor

from torchbrdf.arguments import warn_of_lost_gradient
from torchbrdf.light.latlong import row_solid_angles

_STEPS = 8
"""Implicit steps of diffusion; with more of them the blur is closer to a Gaussian."""


def blur(radiance: Tensor, sigma: float) -> Tensor:
    """Radiance (3, H, 2 H) after diffusion over the sphere, which in small is a Gaussian blur.

    sigma    its standard deviation along any direction, in radians
    The heat equation for a time sigma^2 / 2, in implicit finite volumes: every frequency in azimuth diffuses along the
    meridians by itself, so neither the seam nor the poles are special. Energy is kept, and nothing becomes negative.
    No gradients flow, of which it warns.
    """
    from scipy.linalg import solve_banded  # here, because it is slow to import

    warn_of_lost_gradient(radiance, "the radiance of a light probe through a blur", "no call carries it")
    _, height, width = radiance.shape
    step, azimuth = pi / (height - 1), 2 * pi / width
    area = row_solid_angles(height, width).numpy()
    between = np.sin((np.arange(height - 1) + 0.5) * step) * (azimuth / step)
    around = np.zeros(height)
    around[1:-1] = azimuth * step / np.sin(np.arange(1, height - 1) * step)
    time = sigma**2 / 2 / _STEPS
    along = area.copy()
    along[:-1] += time * between
    along[1:] += time * between
    spectrum = np.fft.rfft(radiance.detach().cpu().double().numpy())
    for m in range(spectrum.shape[-1]):
        bands = np.zeros((3, height))
        bands[0, 1:] = bands[2, :-1] = -time * between
        bands[1] = along + time * (2 * np.sin(m * azimuth / 2) / azimuth) ** 2 * around  # differences of neighbours
        series = spectrum[..., m].T.copy()
        if m:  # a pole has one value
            bands[0, 1] = bands[2, -2] = 0
            series[0] = series[-1] = 0
        for _ in range(_STEPS):
            series = solve_banded((1, 1), bands, area[:, None] * series, check_finite=False)
        spectrum[..., m] = series.T
    return torch.from_numpy(np.fft.irfft(spectrum, n=width).clip(min=0)).to(radiance)  # below is rounding
