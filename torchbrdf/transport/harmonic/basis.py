"""Basis images of one view under one probe in any orientation, by the harmonic transport [CBP21, eq. 5]."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, overload

import numpy as np
import torch
from torch import Tensor

from torchbrdf.arguments import check_types
from torchbrdf.brdf import MaterialLibrary
from torchbrdf.lasting import without_autocast
from torchbrdf.light import LightProbe, checked_rotation
from torchbrdf.transport.basis_images import BasisImages
from torchbrdf.transport.harmonic.cache import transport_of
from torchbrdf.transport.harmonic.light import LINES, LightHarmonics, TurningLight, together
from torchbrdf.transport.harmonic.views import facing, in_perspective, unsuited
from torchbrdf.view import View

_FEW = 24
"""Columns up to which their kernels are mixed rather than mixtures of all: those of a group of rings are as many."""

_AT_ONCE = 8
"""Rotations of one pass: more of them leave the processor's cache."""


class HarmonicBasis:
    """What does not change when the probe turns.

    library   its transport is precomputed on first use, see `transport_of`
    view      without shadows: a `SphereView`, in perspective of a camera at least `NEAREST` radii away, or a
              `NormalMapView` of an orthographic camera along -Z
    progress  show it while the transport is precomputed
    lines, most  of the light, see `TurningLight`
    columns   of the library that are wanted, as if it had no others; None for all
    Raises ValueError for another view, or arguments of other types.
    """

    def __init__(
        self,
        library: MaterialLibrary,
        probe: LightProbe,
        view: View,
        progress: bool = False,
        lines: int = LINES,
        most: int | None = None,
        columns: Sequence[int] | None = None,
    ) -> None:
        """Open the transport of the library."""
        check_types("HarmonicBasis", library=(library, MaterialLibrary), probe=(probe, LightProbe), view=(view, View))
        reason = unsuited(view)
        if reason is not None:
            raise ValueError(f'backend="harmonic" cannot render this view: {reason}; use backend="sampled"')
        self.library, self.probe, self.view, self.lines = library, probe, view, lines
        self.transport = transport_of(library, progress, in_perspective(view))
        self._facing, self._frame = facing(view)
        light = TurningLight(probe.to(self.transport.device), lines)
        self._light = light if most is None else replace(light, most=most)
        self.columns = slice(None) if columns is None else list(columns)
        self.n = library.n if columns is None else len(columns)
        whole = columns is None and library.materials == tuple(range(len(library.stored.names)))
        self._columns = None if whole else library.column_index.to(self.transport.device)[self.columns]

    def __getstate__(self) -> dict[str, Any]:
        """Pickles hold no transport, which is the library's."""
        return {name: value for name, value in vars(self).items() if name != "transport"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Open the transport of the library."""
        vars(self).update(state)
        self.transport = transport_of(self.library, False, in_perspective(self.view))

    def basis_at(self, rotation: Tensor | np.ndarray | None = None) -> BasisImages:
        """The basis images under the probe turned by a rotation (3, 3), as `LightProbe.rotated` turns it.

        Radiance is looked up in turned directions, not resampled as in a rotated probe; a turn about the view axis is a
        phase. Differentiable in the probe's radiance and in the rotation; one backward pass for each `HarmonicBasis`
        of a radiance that requires gradients. The images say that they are of the probe as it is where rotation is
        None, else of no probe in particular. Raises ValueError where rotation is none, or where only some
        columns are wanted.
        """
        if self.columns != slice(None):
            raise ValueError("this HarmonicBasis is of some columns, no basis images of a library; use image_at")
        rotation = _turn(rotation)
        return self.named(self.packed_at(rotation), rotation)

    @without_autocast
    def packed_at(self, rotation: Tensor | None, columns: Sequence[int] | None = None) -> Tensor:
        """(n, 3, P) of `basis_at`, by a rotation that is one; of some columns in place of all n."""
        light = self._light_at(rotation)
        few = self.n if columns is None else len(columns)
        if few <= _FEW:
            chosen = slice(None) if columns is None else columns
            weights = torch.eye(self.n, dtype=torch.float32, device=self.transport.device)[:, chosen]
            return self.transport.blended(light, self._facing, self._whole(weights))
        packed = self.transport.packed(light, self._facing, self._columns)
        return packed if columns is None else packed[columns]

    @without_autocast
    def packed_at_each(self, rotations: Sequence[Tensor]) -> list[Tensor]:
        """(n, 3, P) of each, as `packed_at`; of few columns in half the time, as rotations share passes."""
        if self.n > _FEW:
            return [self.packed_at(rotation) for rotation in rotations]
        weights = self._whole(torch.eye(self.n, dtype=torch.float32, device=self.transport.device))
        found: list[Tensor] = []
        for start in range(0, len(rotations), _AT_ONCE):
            lights = [self._light_at(rotation) for rotation in rotations[start : start + _AT_ONCE]]
            found += self.transport.blended(together(lights), self._facing, weights).unflatten(1, (-1, 3)).unbind(1)
        return found

    def named(self, packed: Tensor, rotation: Tensor | None) -> BasisImages:
        """What `packed_at` a rotation (3, 3) gave, (n, 3, P), with what it is of."""
        basis = BasisImages.of(packed, self.library, self.probe, self.view, "harmonic")
        if rotation is None:
            return basis
        turn = ",".join(f"{value:.9g}" for value in rotation.detach().flatten().tolist())
        return replace(basis, probe=f"{self.probe.fingerprint} turned by {turn}")

    @without_autocast
    def image_at(self, weights: Tensor, rotation: Tensor | np.ndarray | None = None) -> Tensor:
        """(3, P): Y w under the turned probe, for weights (n, 3), without the other basis images.

        Raises ValueError for other weights, or where rotation is none.
        """
        self._check(weights)
        return self._images(self._light_at(_turn(rotation)), weights)[0]

    @without_autocast
    def images_of(self, weights: Tensor) -> Tensor:
        """(K, 3, H, W): K images Y w under the probe as it is, for weights (K, n, 3).

        Of an orthographic camera as fast as a few of `image_at`, and with nothing prepared for the view.
        Raises ValueError for other weights.
        """
        if weights.ndim != 3 or weights.shape[1:] != (self.n, 3) or not len(weights):
            raise ValueError(
                f"weights must be (K, n, 3) = (K, {self.n}, 3) of at least one image, got {tuple(weights.shape)}"
            )
        if in_perspective(self.view):
            return self.view.unpack(torch.stack([self.image_at(each) for each in weights]))
        whole = self._whole(weights)
        return self.view.unpack(self.transport.pictured(self._light_at(None), self._facing, whole))

    @without_autocast
    def change_at(self, weights: Tensor, rotation: Tensor | np.ndarray) -> Tensor:
        """(3, 3, P): how `image_at` changes with further turns about +X, +Y and +Z, per radian.

        An image is linear in the light, so one shows how it changes. Raises ValueError for other weights, or where
        rotation is none.
        """
        self._check(weights)
        change = self._images(self._light.changes(self._in_frame(_turn(rotation).double())), weights)
        return change if self._frame is None else torch.einsum("ij,jcp->icp", self._frame.to(change), change)

    def _light_at(self, rotation: Tensor | None) -> LightHarmonics:
        """As the camera sees it that faces the shape."""
        if rotation is None:
            return self._light.harmonics(None if self._frame is None else self._frame.T)
        return self._light.harmonics(self._in_frame(rotation))

    def _in_frame(self, rotation: Tensor) -> Tensor:
        return rotation if self._frame is None else self._frame.T.to(rotation) @ rotation

    def _check(self, weights: Tensor) -> None:
        if weights.shape != (self.n, 3):
            raise ValueError(
                f"weights must be (n, 3) = ({self.n}, 3), a column for each channel of the image, "
                f"got {tuple(weights.shape)}"
            )

    def _images(self, light: LightHarmonics, weights: Tensor) -> Tensor:
        """(K, 3, P): Y w under K lights."""
        return self.transport.coloured(light, self._facing, self._whole(weights))

    def _whole(self, weights: Tensor) -> Tensor:
        """Weights (..., n, C) of this library's columns as weights of all stored ones."""
        weights = weights.to(self.transport.device)
        if self._columns is None:
            return weights
        whole = weights.new_zeros(*weights.shape[:-2], len(self.transport.groups[0].mixing), weights.shape[-1])
        whole[..., self._columns, :] = weights
        return whole


@overload
def _turn(rotation: Tensor | np.ndarray) -> Tensor: ...
@overload
def _turn(rotation: Tensor | np.ndarray | None) -> Tensor | None: ...
def _turn(rotation: Tensor | np.ndarray | None) -> Tensor | None:
    """A rotation (3, 3) with its graph; ValueError for any other matrix."""
    if rotation is None:
        return None
    checked_rotation(rotation)
    return torch.as_tensor(rotation)
