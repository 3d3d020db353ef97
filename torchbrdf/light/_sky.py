"""Clear skies with their sun as lat-long radiance, from Mitsuba's `sunsky`.

`sunsky` is the sky model of Hosek and Wilkie with their sun [HW12, HW13]. It knows only what is above the horizon:
below, its radiance is 0. Texels get means of it, not values at points: with the hat of texel t, which is 1 at t and
falls linearly to 0 at its neighbours, radiance_t = integral(L hat_t) / integral(hat_t). As hats sum to one, the
bilinear map then has the power of the emitter.
"""

from math import cos, isfinite, pi, radians, sin, sqrt
from types import ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchbrdf.light.latlong import patch_of, row_solid_angles, texel_coordinates
from torchbrdf.mitsuba_startup import is_vectorised, load_mitsuba

SUN_DIAMETER = 0.5358
"""Of the sun's disc in degrees: Mitsuba's default for `sun_aperture`."""

_SUN_VERSINE = 1 - float(np.float32(cos(radians(SUN_DIAMETER / 2))))
"""1 - cos of the disc's radius as Mitsuba has it: too small by 0.2 % in float32, and its disc is that much brighter."""

_LOWEST_SUN = 1e-3
"""Degrees. Mitsuba's emitter is black where its sun is below the horizon by rounding."""

_STEPS_PER_PI = 512
_SUN_POINTS = 4096
_EVALUATIONS_AT_ONCE = 1 << 20


def sky_radiance(
    sun_elevation: float, turbidity: float, sun_azimuth: float, ground_albedo: float, sun: bool, height: int
) -> Tensor:
    """Radiance (3, height, 2 height) float32 of a clear sky; `LightProbe.sky` says what the arguments mean.

    Raises ValueError for values that the model does not know, MitsubaUnavailableError where Mitsuba cannot be loaded.
    """
    if not 0 <= sun_elevation <= 90:
        raise ValueError(f"sun_elevation must be from 0 (horizon) to 90 (zenith) degrees, got {sun_elevation}")
    if not 1 <= turbidity <= 10:
        raise ValueError(f"turbidity must be from 1 (clearest) to 10 (haze), got {turbidity}")
    if not isfinite(sun_azimuth):
        raise ValueError(f"sun_azimuth must be a finite number of degrees, got {sun_azimuth}")
    if not 0 <= ground_albedo <= 1:
        raise ValueError(f"ground_albedo must be from 0 to 1, got {ground_albedo}")
    mi = load_mitsuba()
    elevation, azimuth = radians(max(sun_elevation, _LOWEST_SUN)), radians(sun_azimuth)
    settings = {
        "type": "sunsky",
        "turbidity": float(turbidity),
        "albedo": {"type": "rgb", "value": float(ground_albedo)},
        "sun_direction": [cos(elevation), 0.0, sin(elevation)],  # the emitter's own axes: +Z is up
        "sun_aperture": SUN_DIAMETER,
    }
    radiance = _mean_sky(mi, mi.load_dict({**settings, "sun_scale": 0.0}), azimuth, height)
    if sun:
        centre = torch.tensor([[cos(elevation), 0.0, sin(elevation)]], dtype=torch.float64)
        disc = _evaluate(mi, mi.load_dict({**settings, "sky_scale": 0.0}), centre)[0]
        radiance += _sun_on_texels(disc, elevation, azimuth, height)
    for pole in (0, -1):  # all texels of a pole look in one direction
        radiance[:, pole] = radiance[:, pole].mean(dim=-1, keepdim=True)
    return radiance.float()


def _mean_sky(mi: ModuleType, emitter: Any, azimuth: float, height: int) -> Tensor:
    """(3, height, 2 height) float64: means over hats, by midpoints of steps of which the horizon cuts none."""
    width = 2 * height
    steps = 2 * max(1, round(_STEPS_PER_PI / (2 * (height - 1))))
    u = (torch.arange(steps, dtype=torch.float64) + 0.5) / steps
    phi = (torch.arange(width * steps, dtype=torch.float64) + 0.5) * (2 * pi / (width * steps)) - azimuth
    # What the steps of a column give to the texel before, to its own and to the next one.
    shares = torch.stack([(0.5 - u).clamp_min(0), 1 - (u - 0.5).abs(), (u - 0.5).clamp_min(0)], dim=-1) / steps
    total = torch.zeros(3, height, width, dtype=torch.float64)
    weights = torch.zeros(height, dtype=torch.float64)
    rows = torch.arange(height - 1)
    for block in rows.split(max(1, _EVALUATIONS_AT_ONCE // (width * steps**2))):
        theta = (block[:, None] + u) * (pi / (height - 1))
        seen = _evaluate(mi, emitter, _local_directions(theta.view(-1, 1), phi))
        columns = seen.view(len(block), steps, width, steps, 3).movedim(-1, 0) @ shares
        before, own, following = columns.unbind(-1)
        columns = own + before.roll(-1, dims=-1) + following.roll(1, dims=-1)
        for first, share in ((0, 1 - u), (1, u)):
            weight = torch.sin(theta) * share
            total[:, block + first] += torch.einsum("rs,crsx->crx", weight, columns)
            weights[block + first] += weight.sum(dim=1)
    return total / weights[:, None]


def _local_directions(theta: Tensor, phi: Tensor) -> Tensor:
    """(..., 3) unit vectors in the emitter's axes: +Z up, the sun's azimuth 0 at +X."""
    theta, phi = torch.broadcast_tensors(theta, phi)
    sin_theta = torch.sin(theta)
    return torch.stack([sin_theta * torch.cos(phi), sin_theta * torch.sin(phi), torch.cos(theta)], dim=-1)


def _evaluate(mi: ModuleType, emitter: Any, directions: Tensor) -> Tensor:
    """Radiance (N, 3) float64 from unit vectors (..., 3) in the emitter's axes; 0 below the horizon.

    Colours of low suns and hazy horizons outside the gamut of linear sRGB have negative values: they become 0.
    """
    import drjit as dr

    flat = directions.reshape(-1, 3)
    above = flat[:, 2] >= 0
    radiance = torch.zeros(len(flat), 3, dtype=torch.float64)
    if not above.any():
        return radiance
    towards = flat[above].numpy()
    hit = dr.zeros(mi.SurfaceInteraction3f)
    if is_vectorised(mi):
        hit.wi = mi.Vector3f(*(mi.Float(np.ascontiguousarray(-axis, np.float32)) for axis in towards.T))
        values = np.array(emitter.eval(hit)).T
    else:
        values = np.empty_like(towards)
        for row, direction in enumerate((-towards).tolist()):
            hit.wi = mi.Vector3f(direction)
            values[row] = emitter.eval(hit)
    radiance[above] = torch.nan_to_num(torch.from_numpy(values).double(), posinf=0.0).clamp_min(0)
    return radiance


def _sun_on_texels(disc: Tensor, elevation: float, azimuth: float, height: int) -> Tensor:
    """(3, height, 2 height) float64: a disc of radiance (3,), as points that share its power among the texels around.

    The points lie on a spiral that covers the disc evenly; those below the horizon give nothing.
    """
    index = torch.arange(_SUN_POINTS, dtype=torch.float64)
    off_axis = (index + 0.5) / _SUN_POINTS * _SUN_VERSINE
    turn = index * (pi * (3 - sqrt(5)))
    radius = torch.sqrt(off_axis * (2 - off_axis))
    right = torch.tensor([cos(azimuth), 0.0, sin(azimuth)], dtype=torch.float64)
    towards = [sin(azimuth) * cos(elevation), sin(elevation), -cos(azimuth) * cos(elevation)]
    centre = torch.tensor(towards, dtype=torch.float64)
    across, upwards = torch.cos(turn) * radius, torch.sin(turn) * radius
    top = torch.linalg.cross(right, centre)
    points = (1 - off_axis)[:, None] * centre + across[:, None] * right + upwards[:, None] * top
    points = points[points[:, 1] >= 0]

    width = 2 * height
    column, row, s, t = patch_of(*texel_coordinates(points, height, width)[:2], height, width)
    power = torch.zeros(height, width, dtype=torch.float64)
    for y, share_y in ((row, 1 - t), (row + 1, t)):
        for x, share_x in ((column, 1 - s), ((column + 1) % width, s)):
            power.index_put_((y, x), share_x * share_y, accumulate=True)
    power *= 2 * pi * _SUN_VERSINE / _SUN_POINTS
    return disc[:, None, None] * (power / row_solid_angles(height, width)[:, None])
