"""Kernels of a library's BRDFs as the harmonic transport holds them: mixtures of columns, frequencies in bands.

A group of neighbouring rings sees nearly the same BRDFs. So each group has a basis of its own, mixtures of the
library's columns, and each band of its frequencies a smaller one, for the kernels' even and odd part apart.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchbrdf.transport.harmonic._pages import Pages


@dataclass(frozen=True)
class Band:
    """Azimuth frequencies low, ..., low + M - 1 of a group's kernels: 2 pi times the conjugate series.

    even      (M, E, G r) float32: real parts, of r mixtures; rings before mixtures
    odd       (M, E, G s) float32: imaginary parts, of s other mixtures
    mix_even  (r, R) float32: what these mixtures add to those of the group
    mix_odd   (s, R)
    """

    low: int
    even: Tensor
    odd: Tensor
    mix_even: Tensor
    mix_odd: Tensor

    def to(self, device: torch.device | str) -> "Band":
        """On another device."""
        return Band(self.low, *(getattr(self, name).to(device) for name in ("even", "odd", "mix_even", "mix_odd")))


@dataclass(frozen=True)
class Kernels:
    """One group of rings of one zone.

    order       which of the terms that make a view in perspective; 0 without it
    zone        its index
    first_ring  rings first_ring, ..., first_ring + G - 1
    n_rings     G
    places      along a ring, a multiple of 4, at which the series is summed; the bands make up for what linear
                interpolation between them costs
    first_row   splines over elevation first_row, ..., first_row + E - 1
    mixing      (n, R) float32: image of column k = sum_q mixing[k, q] image of mixture q
    bands       by frequency
    pages       of the file that holds all of it, where it is mapped
    """

    order: int
    zone: int
    first_ring: int
    n_rings: int
    places: int
    first_row: int
    mixing: Tensor
    bands: tuple[Band, ...]
    pages: Pages | None = None

    def sees(self, elevations: range) -> bool:
        """Whether light from some of these elevations reaches its rings."""
        rows = range(self.first_row, self.first_row + self.bands[0].even.shape[1]) if self.bands else range(0)
        return max(rows.start, elevations.start) < min(rows.stop, elevations.stop)

    def mixes(self, blend: Tensor) -> list[tuple[Tensor, Tensor]]:
        """How combinations of the library's columns, with weights (n, C), mix every band's even and odd kernels."""
        combined = self.mixing.T @ blend
        return [(band.mix_even @ combined, band.mix_odd @ combined) for band in self.bands]

    def to(self, device: torch.device | str) -> "Kernels":
        """On another device."""
        if self.mixing.device == torch.device(device):
            return self
        bands = tuple(band.to(device) for band in self.bands)
        return replace(self, mixing=self.mixing.to(device), bands=bands, pages=None)

    def release(self) -> None:
        """What was read of a file leaves the memory of this process."""
        if self.pages is not None:
            self.pages.release()
