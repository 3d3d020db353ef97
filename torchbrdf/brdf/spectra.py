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
