"""Basis images of one view under one probe in any orientation, by the harmonic transport [CBP21, eq. 5]."""

from dataclasses import replace

import torch
from torch import Tensor

from torchbrdf.basis_images import BasisImages
from torchbrdf.harmonic_cache import transport_of
from torchbrdf.library import MaterialLibrary
from torchbrdf.light_harmonics import TurningLight
from torchbrdf.probe import LightProbe, checked_rotation
from torchbrdf.ring_lookup import unsuited
from torchbrdf.view import View


class HarmonicBasis:
    """What does not change when the probe turns.

    library   its transport is precomputed on first use, see `transport_of`
    view      of an orthographic camera along -Z, without shadows: a `SphereView` or a `NormalMapView`
    progress  show it while the transport is precomputed
    Raises ValueError for another view.
    """

    def __init__(self, library: MaterialLibrary, probe: LightProbe, view: View, progress: bool = False) -> None:
        """Open the transport of the library."""
        reason = unsuited(view)
        if reason is not None:
            raise ValueError(f'backend="harmonic" cannot render this view: {reason}; use backend="sampled"')
        self.library, self.probe, self.view = library, probe, view
        self.transport = transport_of(library, progress)
        self._light = TurningLight(probe.to(self.transport.device))
        whole = library.materials == tuple(range(len(library.stored.names)))
        self._columns = None if whole else library.column_index.to(self.transport.device)

    def basis_at(self, rotation: Tensor | None = None) -> BasisImages:
        """The basis images under the probe turned by a rotation (3, 3), as `LightProbe.rotated` turns it.

        Radiance is looked up in turned directions, not resampled as in a rotated probe; a turn about the view axis is a
        phase. Differentiable in the probe's radiance and in the rotation; one backward pass for each `HarmonicBasis`
        of a radiance that requires gradients. The images say that they are of the probe as it is where rotation is
        None, else of no probe in particular. Raises ValueError where rotation is none.
        """
        if rotation is not None:
            rotation = torch.as_tensor(rotation)
            checked_rotation(rotation)
        packed = self.transport.packed(self._light.harmonics(rotation), self.view, self._columns)
        basis = BasisImages.of(packed, self.library, self.probe, self.view, "harmonic")
        if rotation is None:
            return basis
        turn = ",".join(f"{value:.9g}" for value in rotation.detach().flatten().tolist())
        return replace(basis, probe=f"{self.probe.fingerprint} turned by {turn}")
