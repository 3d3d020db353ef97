"""Basis images of one view under one probe in any orientation, by the harmonic transport [CBP21, eq. 5]."""

from dataclasses import replace
from math import radians

import torch
from torch import Tensor

from torchbrdf.brdf import MaterialLibrary
from torchbrdf.light import LightProbe, checked_rotation, rotation_of
from torchbrdf.transport.basis_images import BasisImages
from torchbrdf.transport.harmonic.cache import transport_of
from torchbrdf.transport.harmonic.light import LINES, LightHarmonics, TurningLight, beside
from torchbrdf.transport.harmonic.views import facing, in_perspective, unsuited
from torchbrdf.view import View

_STEP = radians(0.15)
"""Of the differences that tell how an image changes as the light turns."""


class HarmonicBasis:
    """What does not change when the probe turns.

    library   its transport is precomputed on first use, see `transport_of`
    view      without shadows: a `SphereView`, in perspective of a camera at least `NEAREST` radii away, or a
              `NormalMapView` of an orthographic camera along -Z
    progress  show it while the transport is precomputed
    lines     of the light, see `TurningLight`
    Raises ValueError for another view.
    """

    def __init__(
        self, library: MaterialLibrary, probe: LightProbe, view: View, progress: bool = False, lines: int = LINES
    ) -> None:
        """Open the transport of the library."""
        reason = unsuited(view)
        if reason is not None:
            raise ValueError(f'backend="harmonic" cannot render this view: {reason}; use backend="sampled"')
        self.library, self.probe, self.view, self.lines = library, probe, view, lines
        self.transport = transport_of(library, progress, in_perspective(view))
        self._facing, self._frame = facing(view)
        self._light = TurningLight(probe.to(self.transport.device), lines)
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
        packed = self.transport.packed(self._light_at(rotation), self._facing, self._columns)
        basis = BasisImages.of(packed, self.library, self.probe, self.view, "harmonic")
        if rotation is None:
            return basis
        turn = ",".join(f"{value:.9g}" for value in rotation.detach().flatten().tolist())
        return replace(basis, probe=f"{self.probe.fingerprint} turned by {turn}")

    def image_at(self, weights: Tensor, rotation: Tensor | None = None) -> Tensor:
        """(3, P): Y w under the turned probe, for weights (n, 3), without the other basis images.

        Raises ValueError for other weights, or where rotation is none.
        """
        self._check(weights, rotation)
        return self._images(self._light_at(rotation), weights)[0]

    def images_of(self, weights: Tensor) -> Tensor:
        """(K, 3, H, W): K images Y w under the probe as it is, for weights (K, n, 3).

        Of an orthographic camera as fast as a few of `image_at`, and with nothing prepared for the view.
        Raises ValueError for other weights.
        """
        for each in weights:
            self._check(each, None)
        if in_perspective(self.view):
            return self.view.unpack(torch.stack([self.image_at(each) for each in weights]))
        whole = self._whole(weights)
        return self.view.unpack(self.transport.pictured(self._light_at(None), self._facing, whole))

    def change_at(self, weights: Tensor, rotation: Tensor) -> Tensor:
        """(3, 3, P): how `image_at` changes with further turns about +X, +Y and +Z, per radian.

        Central differences over a third of a degree, as fine as the transport resolves: the light is bilinear between
        texels, and its derivative jumps. An image is linear in the light, so one image shows the difference of two.
        Raises ValueError for other weights, or where rotation is none.
        """
        self._check(weights, rotation)
        turned = self._in_frame(rotation.double())
        changes: list[LightHarmonics] = []
        for axis in torch.eye(3, dtype=torch.float64)[:2]:
            after, before = (self._light.harmonics(rotation_of(sign * _STEP * axis) @ turned) for sign in (1, -1))
            changes.append([
                ((a - b) / (2 * _STEP), (ia - ib) / (2 * _STEP))
                for (a, ia), (b, ib) in zip(after, before, strict=True)
            ])  # fmt: skip
        about_view: LightHarmonics = []
        for light, multiple in self._light.harmonics(turned):  # times exp(-i m angle), a turn about +Z
            slope = torch.sin(torch.arange(len(light), device=light.device) * _STEP)[:, None, None] / _STEP
            about_view.append((-slope * multiple, slope * light))
        change = self._images(beside([*changes, about_view]), weights)
        return change if self._frame is None else torch.einsum("ij,jcp->icp", self._frame.to(change), change)

    def _light_at(self, rotation: Tensor | None) -> LightHarmonics:
        """As the camera sees it that faces the shape."""
        if rotation is None:
            return self._light.harmonics(None if self._frame is None else self._frame.T)
        return self._light.harmonics(self._in_frame(rotation))

    def _in_frame(self, rotation: Tensor) -> Tensor:
        return rotation if self._frame is None else self._frame.T.to(rotation) @ rotation

    def _check(self, weights: Tensor, rotation: Tensor | None) -> None:
        if weights.shape != (self.library.n, 3):
            raise ValueError(
                f"weights must be (n, 3) = ({self.library.n}, 3), a column for each channel of the image, "
                f"got {tuple(weights.shape)}"
            )
        if rotation is not None:
            checked_rotation(rotation)

    def _images(self, light: LightHarmonics, weights: Tensor) -> Tensor:
        """(K, 3, P): Y w under K lights that are `beside` each other."""
        blended = self.transport.blended(light, self._facing, self._whole(weights)).unflatten(1, (-1, 3))
        return torch.diagonal(blended, dim1=0, dim2=2).movedim(-1, 1)  # each combination in its own channel

    def _whole(self, weights: Tensor) -> Tensor:
        """Weights (..., n, 3) of this library's columns as weights of all stored ones."""
        if self._columns is None:
            return weights
        whole = weights.new_zeros(*weights.shape[:-2], len(self.transport.groups[0].mixing), 3)
        whole[..., self._columns, :] = weights
        return whole
