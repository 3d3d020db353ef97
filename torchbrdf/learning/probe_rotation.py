"""Light probes turned on the fly, for training: batched, differentiable in the radiance and in the rotation.

`LightProbe.rotated` turns one probe, `HarmonicBasis.basis_at` the light of basis images; see docs/augmentation.md for
which to use when. Imports kornia, so `import torchbrdf` does not import this module.
"""

from collections.abc import Sequence
from math import isfinite, radians
from typing import Any

import torch
from kornia.geometry.conversions import axis_angle_to_rotation_matrix
from kornia.geometry.liegroup import So3
from kornia.geometry.transform import remap
from torch import Tensor

from torchbrdf.lasting import without_autocast
from torchbrdf.learning._drawing import DrawnInFloat32
from torchbrdf.light import area_mean, row_solid_angles, texel_coordinates

SUPERSAMPLING = 5
"""Lookups along each side of a texel."""

_POLE = 1e-6
"""Directions nearer to a pole than this many radians have no azimuth and no gradient."""


@without_autocast
def rotate_probes(
    radiance: Tensor, rotation: Tensor, supersampling: int = SUPERSAMPLING, keep_power: bool = True
) -> Tensor:
    """Turn light probes: radiance that came from d now comes from R d.

    Every texel is the mean of supersampling^2 bilinear lookups over its footprint, weighted by solid angle, so that no
    lamp falls between the lookups; all texels of a pole become one value. `keep_power` then scales each channel by a
    factor near 1, so that sum(radiance * solid angles), the integral over the sphere, stays as it was.
    radiance   (*batch, C, H, 2 H)  linear, texels as in `latlong`
    rotation   (*batch, 3, 3)  orthonormal with determinant +1; batches broadcast
    returns    (*batch, C, H, 2 H), differentiable in both. An unturned probe is smoothed as any other is: its edges
               soften by less than a texel
    Raises ValueError for other shapes or another matrix.
    """
    _check(radiance, rotation, supersampling)
    batch = torch.broadcast_shapes(radiance.shape[:-3], rotation.shape[:-2])
    channels, height, width = radiance.shape[-3:]
    exact = radiance if radiance.dtype == torch.float64 else radiance.float()
    probes = exact.expand(*batch, channels, height, width).reshape(-1, channels, height, width)
    matrices = rotation.to(probes).expand(*batch, 3, 3).reshape(-1, 3, 3)
    # One column more on each side closes the seam; rows end at the poles and need none.
    padded = torch.cat([probes[..., -1:], probes, probes[..., :1]], dim=-1)

    def radiance_of(directions: Tensor) -> Tensor:
        # A row vector times R is R^T d: where the radiance now at d came from.
        source = _beside_the_poles(directions.reshape(-1, 3).to(probes) @ matrices)
        x, y, _ = texel_coordinates(source, height, width)
        # align_corners=True: remap normalises pixels that way whatever it is told.
        seen = remap(padded, x[:, None] + 1, y[:, None], padding_mode="border", align_corners=True)
        return seen.reshape(-1, directions[..., 0].numel()).T.reshape(*directions.shape[:-1], -1)

    turned = area_mean(radiance_of, height, width, supersampling, radiance.device).reshape(probes.shape)
    if keep_power:
        turned = turned * _ratio(_power(probes), _power(turned)).to(probes)
    return turned.reshape(*batch, channels, height, width).to(radiance)


def random_rotations(
    n: int,
    degrees: float | tuple[float, float] | None = None,
    axis: Sequence[float] | None = None,
    device: torch.device | str = "cpu",
    dtype: torch.dtype = torch.float32,
) -> Tensor:
    """(n, 3, 3): random rotations, from torch's global generator.

    degrees  least and largest angle, uniform between; None for the whole turn, with every orientation equally likely
             where the axis is free; a number is an angle between -degrees and degrees
    axis     (3,) of any length above 0; None for one of random direction
    Raises ValueError for other degrees, or another axis.
    """
    degrees, axis = _checked(degrees, axis)
    if degrees is None and axis is None:
        return So3.random(n, device=torch.device(device), dtype=dtype).matrix()
    low, high = (0.0, 360.0) if degrees is None else degrees
    angle = radians(low) + radians(high - low) * torch.rand(n, 1, device=device, dtype=dtype)
    if axis is None:
        along = torch.randn(n, 3, device=device, dtype=dtype)
    else:
        along = torch.tensor([axis], device=device, dtype=dtype).expand(n, 3)
    return axis_angle_to_rotation_matrix(angle * torch.nn.functional.normalize(along, dim=-1))


class RandomProbeRotation(DrawnInFloat32):
    """`rotate_probes` by random rotations, as a kornia augmentation of light probes (B, 3, H, 2 H).

    degrees, axis  see `random_rotations`; a number is an angle between -degrees and degrees
    supersampling, keep_power  see `rotate_probes`
    A mask of usable texels turns along: a texel is usable where all that it shows was. The rotations drawn last are in
    `_params["rotation"]` (B, 3, 3), and may be given: `augmentation(probes, params={"rotation": rotations})`.
    It has no `transform_matrix`: a turned sphere is no homography of its map.
    """

    def __init__(
        self,
        degrees: float | tuple[float, float] | None = None,
        axis: Sequence[float] | None = None,
        supersampling: int = SUPERSAMPLING,
        keep_power: bool = True,
        same_on_batch: bool = False,
        p: float = 1.0,
        keepdim: bool = False,
    ) -> None:
        """Check the range of angles and the axis."""
        super().__init__(p=p, same_on_batch=same_on_batch, keepdim=keepdim)
        span, axis = _checked(degrees, axis)
        self.flags = {"degrees": span, "axis": axis, "supersampling": supersampling, "keep_power": keep_power}

    def generate_parameters(self, batch_shape: tuple[int, ...]) -> dict[str, Tensor]:
        """Draw a rotation for each probe."""
        drawn = random_rotations(
            1 if self.same_on_batch else batch_shape[0],
            self.flags["degrees"],
            self.flags["axis"],
            self.device,
        )
        return {"rotation": drawn.expand(batch_shape[0], 3, 3)}

    def apply_transform(
        self, input: Tensor, params: dict[str, Tensor], flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        """Turn the probes."""
        return rotate_probes(input, params["rotation"], flags["supersampling"], flags["keep_power"])

    def apply_transform_mask(
        self, input: Tensor, params: dict[str, Tensor], flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        """Turn masks of usable texels: 1 where the whole footprint is usable."""
        turned = rotate_probes(input, params["rotation"], flags["supersampling"], keep_power=False)
        return (turned > 1 - 1e-4).to(input.dtype)

    def apply_non_transform_mask(
        self, input: Tensor, params: dict[str, Tensor], flags: dict[str, Any], transform: Tensor | None = None
    ) -> Tensor:
        """Masks of probes that are not turned."""
        return input


def _checked(
    degrees: float | tuple[float, float] | None, axis: Sequence[float] | None
) -> tuple[tuple[float, float] | None, tuple[float, ...] | None]:
    """The range of angles and the axis; ValueError where they are none."""
    span = (-degrees, degrees) if isinstance(degrees, int | float) else degrees
    if span is not None and not (len(span) == 2 and all(map(isfinite, span)) and span[0] <= span[1]):
        raise ValueError(f"degrees must be an angle or a range (low, high) of them, got {degrees}")
    if axis is not None and not (len(axis) == 3 and all(map(isfinite, axis)) and any(axis)):
        raise ValueError(f"axis must be three finite numbers, not all zero, got {axis}")
    return span, None if axis is None else tuple(axis)


def _power(radiance: Tensor) -> Tensor:
    """(B, C, 1, 1) float64: the integral over the sphere."""
    weights = row_solid_angles(radiance.shape[-2], radiance.shape[-1], radiance.device)[:, None]
    return (radiance.double() * weights).sum((-2, -1), keepdim=True)


def _ratio(wanted: Tensor, found: Tensor) -> Tensor:
    """wanted / found, 1 where there is no light."""
    lit = found > 0
    return torch.where(lit, wanted / torch.where(lit, found, 1), 1)


def _beside_the_poles(directions: Tensor) -> Tensor:
    """Unit vectors (..., 3) with those at a pole moved off it: atan2 has no gradient there, only NaN."""
    x, y, z = directions.unbind(-1)
    at_pole = x.detach().square() + z.detach().square() < _POLE**2
    return torch.stack([torch.where(at_pole, _POLE, x), y, torch.where(at_pole, 0, z)], dim=-1)


def _check(radiance: Tensor, rotation: Tensor, supersampling: int) -> None:
    if radiance.ndim < 3 or radiance.shape[-1] != 2 * radiance.shape[-2] or radiance.shape[-2] < 2:
        raise ValueError(f"light probes must be lat-long (*batch, C, H, 2 H), got {tuple(radiance.shape)}")
    if not radiance.is_floating_point():
        raise ValueError(f"light probes must hold linear floating-point radiance, got {radiance.dtype}")
    if supersampling < 1:
        raise ValueError(f"supersampling must be at least 1, got {supersampling}")
    if rotation.shape[-2:] != (3, 3):
        raise ValueError(f"rotation must be (*batch, 3, 3), got {tuple(rotation.shape)}")
    found = rotation.detach().double()
    error = (found @ found.mT - torch.eye(3, dtype=torch.float64, device=found.device)).abs().amax()
    if found.numel() and not (error < 1e-4 and bool((torch.linalg.det(found) > 0).all())):
        raise ValueError(f"rotation must be orthonormal with determinant +1, got |R R^T - 1| up to {float(error):.2g}")
