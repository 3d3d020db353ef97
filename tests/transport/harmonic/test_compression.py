"""Kernels of groups of rings: what compression loses of the integrals of all columns."""

from math import pi

import pytest
import torch
from torch import Tensor

from coarse_grids import HALF_GRID
from torchbrdf.brdf import MaterialLibrary, column_norms
from torchbrdf.transport.harmonic._compression import TOLERANCE, _Group
from torchbrdf.transport.harmonic._integrals import GroupIntegrals, Mixtures
from torchbrdf.transport.harmonic._kernels import Kernels
from torchbrdf.transport.harmonic.grid import Zone, zones


@pytest.fixture(autouse=True)
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in HALF_GRID.items():
        monkeypatch.setattr(name, value)


def expanded(kernels: Kernels, zone: Zone) -> Tensor:
    """(2, M, E, G, n): real and imaginary parts of the series of all columns."""
    n = len(kernels.mixing)
    found = torch.zeros(2, zone.frequencies, kernels.bands[0].even.shape[1], kernels.n_rings, n)
    for band in kernels.bands:
        frequencies = slice(band.low, band.low + len(band.even))
        for i, (part, mix) in enumerate(((band.even, band.mix_even), (band.odd, band.mix_odd))):
            of_rings = part.unflatten(2, (kernels.n_rings, len(mix)))
            found[i, frequencies] = of_rings @ (mix @ kernels.mixing.T)
    frequency = torch.arange(zone.frequencies, dtype=torch.float32)
    return found * torch.sinc(frequency / kernels.places).square()[:, None, None, None]


def integrated(library: MaterialLibrary, orders: tuple[int, ...], zone: Zone, rings: range) -> list[Tensor]:
    """The same without mixtures, for every order."""
    n = library.n
    each = Mixtures(torch.eye(n, dtype=torch.float64).repeat(1, 2), n)
    spectra = GroupIntegrals(library.stored, orders, zone, rings).spectra(each)
    return [torch.stack(both).permute(0, 4, 2, 1, 3) for both in spectra]


def lost(library: MaterialLibrary, orders: tuple[int, ...], index: int) -> Tensor:
    """(orders, n): what the middle group of a zone loses, in terms of what it may."""
    zone, norms = zones()[index], column_norms(library.stored)
    rings = zone.groups[len(zone.groups) // 2]
    group = _Group(library.stored, orders, zone, rings, norms, len(zones()))
    share = float(zone.ring_measure[rings.start : rings.stop].sum() / zone.ring_measure.sum())
    scale = group._scale().permute(3, 1, 0, 2) / pi**0.5  # makes moments square integrals
    found = []
    for kernels, exact in zip(group.kernels(), integrated(library, orders, zone, rings), strict=True):
        difference = (expanded(kernels, zone) - exact) * scale
        found.append(difference.flatten(0, 3).norm(dim=0) / norms)
        assert kernels.mixing.shape[1] < library.n
    return torch.stack(found) / (TOLERANCE * (share / len(zones())) ** 0.5)


@pytest.mark.parametrize("index", [0, 3])
def test_of_an_orthographic_camera(tiny_library: MaterialLibrary, index: int):
    assert float(lost(tiny_library, (0,), index).max()) < 1


def test_of_perspective(tiny_library: MaterialLibrary):
    """Half as much again may be lost of what is added."""
    assert float(lost(tiny_library, (1, 2), 3).max()) < 1.5
