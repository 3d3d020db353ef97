"""Which pixels of a photographed ball to use: masks (*batch, 1, H, W) bool, True = use.

`hiding` draws from these at random. Imports kornia, so `import torchbrdf` does not import this module.
"""

from collections.abc import Sequence
from math import isfinite

import torch
from kornia.morphology import erosion
from torch import Tensor

from torchbrdf.lasting import without_autocast
from torchbrdf.view import SphereView, View

MARGIN = 1.0
"""Pixels around what is hidden that are left out, too."""


def erode_silhouette(mask: Tensor, pixels: float) -> Tensor:
    """Leave out what is nearer than a distance to a pixel that is not used, or to the border of the image.

    mask     (*batch, 1, H, W)  bool
    pixels   between centres of pixels; below 1 nothing changes
    returns  (*batch, 1, H, W)
    """
    if mask.ndim < 3 or mask.dtype != torch.bool:
        raise ValueError(f"mask must be (*batch, 1, H, W) bool, got {mask.dtype} {tuple(mask.shape)}")
    if not (isfinite(pixels) and pixels >= 0):
        raise ValueError(f"pixels must be a distance of at least 0, got {pixels}")
    if pixels < 1:
        return mask
    reach = torch.arange(-int(pixels), int(pixels) + 1, device=mask.device).square()
    disc = (reach[:, None] + reach <= pixels**2).float()
    flat = mask.reshape(-1, 1, *mask.shape[-2:]).float()
    return (erosion(flat, disc, border_type="constant", border_value=0.0) > 0.5).reshape(mask.shape)


def mask_saturated(image: Tensor, threshold: float, margin: float = MARGIN) -> Tensor:
    """Leave out pixels with a channel at or above a threshold, or not finite, and what is within `margin` pixels.

    image    (*batch, 3, H, W)  linear radiance; the threshold is a little below the sensor's largest value, in its unit
    margin   bright pixels spill into their neighbours: lens, demosaicking, resampling
    returns  (*batch, 1, H, W)
    """
    if image.ndim < 3:
        raise ValueError(f"image must be (*batch, 3, H, W), got {tuple(image.shape)}")
    sound = (image < threshold).all(-3, keepdim=True) & torch.isfinite(image).all(-3, keepdim=True)
    return grown(sound, margin)


def mask_stand(view: SphereView, radius: float | Tensor, margin: float = MARGIN) -> Tensor:
    """Leave out what an upright stand below the ball hides, and the ball's reflection of the stand.

    The stand is a cylinder about the vertical axis through the centre, from the ball downwards.
    radius   (*batch,)  of the cylinder in radii of the ball, 0 to 1
    margin   pixels around: the blur of a lobe that is no mirror's, and of the camera
    returns  (*batch, 1, H, W), False outside the ball, too
    """
    if not isinstance(view, SphereView):
        raise ValueError(f"mask_stand knows the stand of a SphereView only, got {type(view).__name__}")
    wide = torch.as_tensor(radius, dtype=torch.float32)
    if not bool(((wide >= 0) & (wide < 1)).all()):
        raise ValueError(f"radius of the stand must lie in [0, 1) radii of the ball, got {radius}")
    clear = stand_radii(view).to(wide.device) >= wide[..., None, None, None]
    return grown(clear, margin) & view.mask.to(wide.device)


def mask_reflection(
    view: View, half_angle_deg: float | Tensor, direction: Sequence[float] = (0.0, 0.0, 1.0), margin: float = MARGIN
) -> Tensor:
    """Leave out pixels that mirror a distant disc: the camera, a photographer, a lamp to be taken out.

    half_angle_deg  (*batch,)  half of the angle that the disc fills, seen from the shape
    direction       towards it in world space, any length; (0, 0, 1) is the camera's
    margin          as for `mask_stand`
    returns         (*batch, 1, H, W), False outside the shape, too
    """
    angle = torch.as_tensor(half_angle_deg, dtype=torch.float32)
    if not bool(((angle >= 0) & (angle <= 180)).all()):
        raise ValueError(f"half_angle_deg must lie between 0 and 180 degrees, got {half_angle_deg}")
    clear = reflection_angles(view, direction).to(angle.device) >= angle[..., None, None, None]
    return grown(clear, margin) & view.mask.to(angle.device)


def stand_radii(view: SphereView) -> Tensor:
    """(1, H, W): radius of the thinnest stand that each pixel shows, directly or in a mirror; infinite where none.

    Outside the ball x^2 + z^2 > 1 - y^2, so a point below the equator lies in the stand of radius s as soon as
    x^2 + z^2 < s^2: the radius is the least distance of the mirrored ray from the axis, where the ray is that low.
    """
    points, rays = _mirrored_rays(view)
    (x, y, z), (r_x, r_y, r_z) = points, rays
    level = torch.where(r_y == 0, torch.inf, -y / r_y)  # where the ray crosses the height of the centre
    falling = r_y < 0
    first = torch.where(falling, level.clamp_min(0), 0)
    last = torch.where(falling, torch.inf, level)
    nearest = -(x * r_x + z * r_z) / (r_x * r_x + r_z * r_z).clamp_min(1e-12)
    t = torch.minimum(torch.maximum(nearest, first), last)
    distance = torch.hypot(x + t * r_x, z + t * r_z)
    distance = torch.where(falling | (y < 0), distance, torch.inf)
    return torch.where(view.mask, view.unpack(distance.amin(-1)), torch.inf)


@without_autocast
def reflection_angles(view: View, direction: Sequence[float]) -> Tensor:
    """(1, H, W): the least angle in degrees between a direction and what each pixel mirrors; 180 outside the mask."""
    towards = torch.tensor(direction, dtype=torch.float32)
    if towards.shape != (3,) or not bool(towards.any()):
        raise ValueError(f"direction must be three numbers, not all zero, got {direction}")
    _, rays = _mirrored_rays(view)
    cosine = torch.einsum("kps,k->ps", rays, towards / towards.norm()).clamp(-1, 1)
    return torch.where(view.mask, view.unpack(torch.rad2deg(torch.acos(cosine)).amin(-1)), 180.0)


def _mirrored_rays(view: View) -> tuple[Tensor, Tensor]:
    """(3, P, 9) each: normals at nine places of every pixel, its corners too, and where a mirror there would look."""
    sides = torch.tensor([0.0, 0.5, 1.0], dtype=torch.float32)
    places = torch.cartesian_prod(sides, sides).T[:, None].expand(2, len(view.pixels), 9)
    seen = view.surface(view.pixels, places[0], places[1])
    n, v = seen.normals.float(), seen.view_dirs.float()
    return n, 2 * (n * v).sum(0) * n - v


def grown(mask: Tensor, margin: float) -> Tensor:
    """Less what is within a margin of what is left out; the border of the image is no reason."""
    extra = int(margin)
    outside = torch.nn.functional.pad(mask, (extra,) * 4, value=True)
    return erode_silhouette(outside, margin)[..., extra : extra + mask.shape[-2], extra : extra + mask.shape[-1]]
