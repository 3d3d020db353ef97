"""Spheres of a few reconstructed BRDFs under a light that turns, as fast as a hand moves [CBP21, eq. 1].

An image is linear in the BRDF: the harmonic transport's mixtures are blended by the weights before anything is done for
pixels, so a frame costs a tenth of a whole basis. Where B w is negative, radiance below zero becomes zero; a table
saved from the same weights has its negative cells set to zero instead.
"""

from collections.abc import Sequence
from functools import cached_property
from math import pi

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from torchbrdf.brdf import MaterialLibrary
from torchbrdf.estimation import Reconstruction
from torchbrdf.light import LightProbe
from torchbrdf.transport.harmonic import (
    SUPPORT,
    HarmonicTransport,
    TurningLight,
    Zone,
    frequencies_of,
    spectrum,
    transport_of,
    zones,
)
from torchbrdf.view import SphereView

_LINES = 288
_FREQUENCIES = (112, 80, 56, 40)
"""Of the light, in every zone: enough for what a picture of some hundred pixels shows."""


class Relighter:
    """Spheres of K BRDFs under a probe that turns.

    transport  of all columns of a library
    weights    (K, n, 3)  of all its columns
    labels     one for each
    size       pixels along a side of the images
    """

    def __init__(
        self, transport: HarmonicTransport, weights: Tensor, labels: Sequence[str], probe: LightProbe, size: int
    ) -> None:
        """Blend the mixtures of the transport by the weights."""
        self.labels = tuple(labels)
        self.probe = probe
        self._view = SphereView(size)
        self.mask = self._view.mask
        self.transport = transport
        columns = weights.detach().float().permute(1, 0, 2).flatten(1)  # (n, 3 K)
        self._mixes = [group.mixes(columns) for group in transport.groups]
        self._light = TurningLight(probe, _LINES)
        self._zones = zones()
        self._duals = [zone.ring_dual.float() for zone in self._zones]

    @classmethod
    def of(cls, library: MaterialLibrary, result: Reconstruction, probe: LightProbe, size: int) -> "Relighter":
        """The result and the candidate of every class of one reconstruction.

        library  the one of the result's basis images
        Raises ValueError for another library, or a batch (pick one with result[i]).
        """
        result.check_library(library, "Relighter.of")
        likeliest = int(result.class_index)
        names = [f"class {j}{' (likeliest)' if j == likeliest else ''}" for j in range(len(result.class_weights))]
        weights = torch.zeros(1 + len(names), library.stored.columns.shape[1], 3, dtype=torch.float32)
        found = torch.cat([result.weights[None], result.class_weights]).detach()
        weights[:, library.column_index] = found.to("cpu", torch.float32)
        return cls(transport_of(library, progress=True), weights, ("result", *names), probe, size)

    def render(self, rotation: Tensor) -> Tensor:
        """(K, 3, S, S) float32: radiance under the probe turned by a rotation (3, 3), 0 outside the mask."""
        light = self._light.harmonics(rotation)
        total = torch.zeros(len(self._view.pixels), 3 * len(self.labels), dtype=torch.float32)
        for zone, (places, weights) in zip(self._zones, self._lookups, strict=True):
            rings = self._rings(zone, light[zone.index])
            total += embedding_bag(places, rings, mode="sum", per_sample_weights=weights)
        return self._view.unpack(total.clamp_min_(0).T.unflatten(0, (len(self.labels), 3)))

    def mirror_ball(self, rotation: Tensor) -> Tensor:
        """(3, S, S) float32: the probe turned by a rotation (3, 3), in a perfect mirror."""
        return self._view.unpack(self.probe.radiance_at(self._mirrored @ rotation.to(self._mirrored)).T)

    @cached_property
    def _mirrored(self) -> Tensor:
        """(P, 3): the directions that the pixels' centres mirror to the camera."""
        n = self._view.pack(self._view.normals).T
        mirrored = 2 * n[:, 2:] * n
        mirrored[:, 2] -= 1
        return mirrored

    def _rings(self, zone: Zone, light: tuple[Tensor, Tensor]) -> Tensor:
        """(rings A, 3 K): coefficients of the splines across the rings, at A places along them."""
        contained = min(frequencies_of(light[0]), _FREQUENCIES[zone.index])
        series = torch.zeros(zone.rings, 3 * len(self.labels), contained, dtype=torch.complex64)
        for group, mixes in zip(self.transport.groups, self._mixes, strict=True):
            if group.zone != zone.index:
                continue
            found = spectrum(group, light, contained, mixes).unflatten(-1, (-1, 3))
            own = torch.diagonal(found, dim1=3, dim2=5)  # each channel of a BRDF in its own colour of the light
            real, imaginary = own.permute(1, 2, 3, 4, 0).flatten(2, 3)
            rings = slice(group.first_ring, group.first_ring + group.n_rings)
            series[rings, :, : len(found)] = torch.complex(real, imaginary)
        dual = self._duals[zone.index]
        series = torch.view_as_complex((dual @ torch.view_as_real(series).flatten(1)).view(*series.shape, 2))
        along = torch.fft.irfft(series, n=_places(zone), norm="forward")
        return along.transpose(1, 2).flatten(0, 1).contiguous()

    @cached_property
    def _lookups(self) -> list[tuple[Tensor, Tensor]]:
        """For every zone: places (P, 8) int64 and weights (P, 8) of the pixels' centres."""
        x, y, z = self._view.pack(self._view.normals).double()
        gamma, alpha = torch.atan2(torch.hypot(x, y), z), torch.atan2(y, x)
        found = []
        for zone in self._zones:
            first, across = zone.ring_splines(gamma)
            n = _places(zone)
            around = torch.remainder(alpha * (n / (2 * pi)), n)
            low = around.floor()
            rings = first[:, None] + torch.arange(SUPPORT)
            along = torch.stack([low.long() % n, (low.long() + 1) % n], 1)
            share = torch.stack([1 - (around - low), around - low], 1)
            places = rings[:, :, None] * n + along[:, None]
            weights = across[:, :, None] * share[:, None]
            found.append((places.flatten(1), weights.flatten(1).float()))
        return found


def _places(zone: Zone) -> int:
    return 2 * _FREQUENCIES[zone.index]
