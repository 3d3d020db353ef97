"""Spectra of reflectance as linear Rec. 709 under daylight D65, as Mitsuba's spectral variants show them, and back.

A white surface, 1 at every wavelength, is (1, 1, 1). Between wavelengths spectra are linear, beyond the first and the
last they are constant, as Mitsuba's `measured` reads them.
"""

from functools import lru_cache

import numpy as np

from torchbrdf.brdf._cie import D65, OBSERVER, WAVELENGTHS

_REC709_OF_XYZ = np.array(
    [[3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]]
)
"""Linear Rec. 709 of CIE XYZ [ITU-R BT.709]."""

SPECTRAL_NODES = np.linspace(400.0, 700.0, 13)
"""(13,) nm: where the spectra are given that stand for colours."""

_EXACTLY = 1e4
"""How much more the colours of `basis_spectra` count than their smoothness."""

_STEP = 0.25
"""In nm, of the sum that stands for the integral: wavelengths of files and of the CIE's table fall on it or near."""


def to_rec709(wavelengths: np.ndarray) -> np.ndarray:
    """(3, n) float64: what takes a spectrum, given at increasing wavelengths (n,) in nm, to linear Rec. 709.

    R G B = M integral of s(l) D65(l) xyz(l) dl / integral of D65(l) y(l) dl, scaled so that s = 1 is (1, 1, 1)
    """
    fine = np.arange(WAVELENGTHS[0], WAVELENGTHS[-1] + _STEP / 2, _STEP)
    seen = np.interp(fine, WAVELENGTHS, D65) * np.stack([np.interp(fine, WAVELENGTHS, c) for c in OBSERVER.T])
    weights = _REC709_OF_XYZ @ seen
    weights /= weights.sum(1, keepdims=True)
    hats = np.stack([np.interp(fine, wavelengths, one) for one in np.eye(len(wavelengths))], 1)
    return weights @ hats


@lru_cache(maxsize=1)
def basis_spectra() -> np.ndarray:
    """(13, 3) float64 in [0, 1] at `SPECTRAL_NODES`: the smoothest spectra of red, green and blue that sum to 1.

    A colour times these is a spectrum of this colour under D65, of no more than 1 where the colour is, as in [MY19].
    """
    from scipy.optimize import lsq_linear

    n = len(SPECTRAL_NODES)
    bends = np.kron(np.eye(3), np.diff(np.eye(n), 2, axis=0))
    colours = np.kron(np.eye(3), to_rec709(SPECTRAL_NODES))
    sums = np.tile(np.eye(n), 3)
    rows = np.concatenate([bends, _EXACTLY * colours, _EXACTLY * sums])
    wanted = np.concatenate([np.zeros(len(bends)), _EXACTLY * np.eye(3).ravel(), np.full(n, _EXACTLY)])
    return lsq_linear(rows, wanted, bounds=(0, 1), tol=1e-14).x.reshape(3, n).T
