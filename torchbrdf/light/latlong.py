"""The geometry of lat-long radiance: texels, directions, bilinear lookup, solid angles, resampling.

Texel (x, y) of a `(channels, H, W)` map stands at phi = 2 pi (x + 0.5) / W, theta = pi y / (H - 1): columns
are texel-centred, the first and last rows are the poles. Between texels radiance is bilinear in (phi, theta)
and wraps in phi. The direction is (sin phi sin theta, cos theta, -cos phi sin theta), +Y up. This is
Mitsuba 3's `envmap`; `torch.nn.functional.grid_sample` matches neither axis alone.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

LEAST_HEIGHT = 512
"""Of what is made of a picture of texels that cover cells: bilinear lookups blur those less the finer they are cut.

The harmonic transport resolves 600 rows, so that as many cost it no time.
"""

CPU_CHUNK = 1 << 15  # directions at a time: on a CPU the intermediate arrays then stay in cache
_AREA_MEAN_CHUNK = 1 << 20
_ROTATION_CHUNK = 1 << 17


def directions_at(x: Tensor, y: Tensor, height: int, width: int) -> Tensor:
    """Unit vectors (..., 3) of texel coordinates x, y (...), which may be fractional."""
    phi = (x + 0.5) * (2 * math.pi / width)
    theta = y * (math.pi / (height - 1))
    sin_theta = torch.sin(theta)
    across, forward = torch.sin(phi) * sin_theta, -torch.cos(phi) * sin_theta
    return torch.stack([across, torch.cos(theta).expand_as(across), forward], dim=-1)


def texel_coordinates(directions: Tensor, height: int, width: int) -> tuple[Tensor, Tensor, Tensor]:
    """Fractional texel coordinates x in [-0.5, W - 0.5] and y in [0, H - 1] of unit vectors, and sin theta.

    theta comes from atan2: acos in float32 is off by half a texel of a large map near the poles.
    """
    d_x, d_y, d_z = directions.unbind(-1)
    return _coordinates(d_x, d_y, d_z, height, width)


def _coordinates(d_x: Tensor, d_y: Tensor, d_z: Tensor, height: int, width: int) -> tuple[Tensor, Tensor, Tensor]:
    sin_theta = torch.hypot(d_x, d_z)
    x = torch.atan2(d_x, -d_z) * (0.5 * width / math.pi)
    x = torch.where(x < 0, x + width, x) - 0.5
    y = torch.atan2(sin_theta, d_y) * ((height - 1) / math.pi)
    return x, y, sin_theta


def patch_of(x: Tensor, y: Tensor, height: int, width: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The patch between four texels that holds (x, y): its first column and row (int64), (s, t) inside."""
    column = torch.floor(x)
    row = torch.floor(y).clamp(0, height - 2)
    s, t = x - column, (y - row).clamp(0, 1)
    column = column.long()
    return torch.where(column < 0, column + width, column), row.long(), s, t


def bilinear(radiance: Tensor, directions: Tensor) -> Tensor:
    """Radiance (channels, H, W) seen in unit directions (..., 3): (..., channels), differentiable in both."""
    channels, height, width = radiance.shape
    texels = radiance.reshape(channels, -1).t().contiguous()
    flat = directions.reshape(-1, 3)
    chunks = flat.split(flat.shape[0] if flat.is_cuda or flat.shape[0] == 0 else CPU_CHUNK)
    seen = torch.cat([_bilinear(texels, chunk, height, width) for chunk in chunks])
    return seen.reshape(*directions.shape[:-1], channels)


def _bilinear(texels: Tensor, directions: Tensor, height: int, width: int) -> Tensor:
    first, following, s, t = _corners(*texel_coordinates(directions, height, width)[:2], height, width)
    s, t = s[:, None].to(texels.dtype), t[:, None].to(texels.dtype)
    upper = torch.lerp(texels.index_select(0, first), texels.index_select(0, following), s)
    first, following = first + width, following + width
    lower = torch.lerp(texels.index_select(0, first), texels.index_select(0, following), s)
    return torch.lerp(upper, lower, t)


def _corners(x: Tensor, y: Tensor, height: int, width: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Of the patch that holds (x, y): the flat indices of its two upper texels, those below are `width` on; (s, t)."""
    column, row, s, t = patch_of(x, y, height, width)
    first = row * width
    following = first + torch.where(column == width - 1, 0, column + 1)
    return first + column, following, s, t


def row_solid_angles(height: int, width: int, device: torch.device | str = "cpu") -> Tensor:
    """The integral over the sphere of one texel's bilinear hat, per row: (H,) float64, in sr.

    With d = pi / (H - 1): (2 pi / W) sin(theta_y) 2 (1 - cos d) / d inside, (2 pi / W) (1 - sin(d) / d) at
    the poles. The hats sum to one, so that W times the sum is 4 pi, and sum(radiance * solid angles) is the
    exact integral of the bilinear radiance.
    """
    d = math.pi / (height - 1)
    theta = torch.arange(height, dtype=torch.float64, device=device) * d
    rows = torch.sin(theta) * (4 * math.sin(d / 2) ** 2 / d)
    rows[0] = rows[-1] = 1 - math.sin(d) / d
    return rows * (2 * math.pi / width)


def rotate(radiance: Tensor, rotation: Tensor, supersampling: int = 5) -> Tensor:
    """The map whose radiance from R d is that of `radiance` from d, both (channels, H, W).

    A texel is the mean of bilinear lookups over its footprint (`area_mean`); a turn about +Y by whole texels
    is `torch.roll`, which is exact.
    """
    _, height, width = radiance.shape
    (_, r_xy, r_xz), (r_yx, r_yy, r_yz), (_, r_zy, r_zz) = rotation.tolist()
    if r_yy > 0 and max(abs(r_xy), abs(r_yx), abs(r_yz), abs(r_zy)) < 1e-6:
        columns = -math.atan2(r_xz, r_zz) * width / (2 * math.pi)
        if abs(columns - round(columns)) < 1e-4:
            return torch.roll(radiance, round(columns), dims=-1)
    theta, weights = (each.to(radiance.device, torch.float32) for each in _strips(height, supersampling))
    phi = (torch.arange(supersampling * width, dtype=torch.float64) + 0.5) * (2 * math.pi / supersampling / width)
    # A row vector times R is R^T d: where the radiance now at d came from. R^T d = sin(theta) around + cos(theta) up.
    around = torch.outer(torch.sin(phi), rotation[0]) - torch.outer(torch.cos(phi), rotation[2])
    around, up = (each.to(radiance.device, torch.float32) for each in (around, rotation[1]))
    texels = radiance.flatten(1).t().contiguous()
    at_once = max(1, _ROTATION_CHUNK // (width * supersampling**2))
    rows = []
    for part, weight in zip(theta[..., None].split(at_once), weights.split(at_once), strict=True):
        sine, cosine = torch.sin(part), torch.cos(part)
        d_x, d_y, d_z = (torch.addcmul(cosine * up[k], sine, around[:, k]) for k in range(3))
        corners = _corners(*_coordinates(d_x, d_y, d_z, height, width)[:2], height, width)
        seen = _sums(texels, *corners, width, supersampling).unflatten(0, (*part.shape[:2], width))
        rows.append(torch.einsum("ypxc,yp->yxc", seen, weight / supersampling))
    return _one_value_at_the_poles(torch.cat(rows).permute(2, 0, 1).contiguous())


def _sums(texels: Tensor, first: Tensor, following: Tensor, s: Tensor, t: Tensor, width: int, count: int) -> Tensor:
    """(N / count, channels): of each `count` bilinear lookups in a row, by their `_corners` (N)."""
    both = s * t
    taps = (first, 1 - s - t + both), (following, s - both), (first + width, t - both), (following + width, both)
    return torch.stack([
        embedding_bag(index.view(-1, count), texels, mode="sum", per_sample_weights=share.to(texels).view(-1, count))
        for index, share in taps
    ]).sum(0)


def area_mean(
    radiance_of: Callable[[Tensor], Tensor],
    height: int,
    width: int,
    supersampling: int,
    device: torch.device | str = "cpu",
) -> Tensor:
    """A map (channels, height, width) float32 of the function radiance_of((..., 3)) -> (..., channels).

    Each texel is the mean of `supersampling`^2 values over its footprint: one texel in phi, and in theta a strip as
    large as the texel's solid angle, so that sum(map * solid angles) is the function's integral as far as the values
    see it. The strips are one texel high but for the first few rows at the poles, which are a cap of 0.577 texels,
    then 0.950, 0.989, ...: those beside the poles are seen 0.12 texels off their centres. All texels of a pole are the
    mean of its cap.
    """
    theta, weights = (each.to(device, torch.float32) for each in _strips(height, supersampling))
    columns = torch.arange(width, device=device, dtype=torch.float32)[None, :, None]
    offsets = (torch.arange(supersampling, device=device, dtype=torch.float32) + 0.5) / supersampling - 0.5
    at_once = max(1, _AREA_MEAN_CHUNK // (height * width))
    total = torch.zeros((), device=device, dtype=torch.float32)
    for y, weight in zip(theta.T * ((height - 1) / math.pi), weights.T / supersampling, strict=True):
        for dx in offsets.split(at_once):
            seen = radiance_of(directions_at(columns + dx, y[:, None, None], height, width))
            total = total + weight[:, None, None] * seen.sum(dim=2)
    return _one_value_at_the_poles(total.permute(2, 0, 1).contiguous())


def _strips(height: int, parts: int) -> tuple[Tensor, Tensor]:
    """(H, parts) float64: the theta to look up in each part of a row's strip, its share of the strip's area.

    A strip is as large as the row's solid angle. theta is the mean over the part's area, which is exact for radiance
    that is linear in theta there.
    """
    edges = 2 * torch.asin(_strip_edges(height).sqrt())
    edges = torch.lerp(edges[:-1, None], edges[1:, None], torch.linspace(0, 1, parts + 1, dtype=torch.float64))
    upper, lower = edges[:, :-1], edges[:, 1:]
    area = 2 * torch.sin((upper + lower) / 2) * torch.sin((lower - upper) / 2)
    moment = (torch.sin(lower) - lower * torch.cos(lower)) - (torch.sin(upper) - upper * torch.cos(upper))
    theta, share = moment / area, area / area.sum(1, keepdim=True)
    northern = torch.arange(height)[:, None] < (height + 1) // 2  # others mirror them: there differences cancel
    return torch.where(northern, theta, math.pi - theta.flip(0, 1)), torch.where(northern, share, share.flip(0, 1))


def _strip_edges(height: int) -> Tensor:
    """(H + 1,) float64: the share of the sphere above each edge of the rows' strips, sin^2(theta / 2) there."""
    areas = row_solid_angles(height, 1)
    return (torch.cat([areas.new_zeros(1), areas.cumsum(0)]) / (4 * math.pi)).clamp_max(1)


def from_bands(radiance: Tensor, height: int) -> Tensor:
    """The map (channels, height, 2 height) float32 of a picture (channels, h, w) of texels that cover cells.

    Texel (x, y) of the picture is constant over phi from 2 pi x / w to 2 pi (x + 1) / w and theta from pi y / h to
    pi (y + 1) / h. Means over the footprints of `area_mean`, cut exactly: the energy is the picture's.
    """
    old_height = radiance.shape[1]
    bands = torch.sin(torch.arange(old_height + 1, dtype=torch.float64) * (math.pi / 2 / old_height)) ** 2
    return _one_value_at_the_poles(_cell_means(_columns_of(radiance, height), bands, _strip_edges(height)))


def from_edge_columns(radiance: Tensor) -> Tensor:
    """The map of one whose rows lie as ours and whose columns run from edge to edge, both of one azimuth.

    So the OpenEXR library defines lat-long environment maps: column x of W is at phi = 2 pi x / (W - 1).
    """
    width = radiance.shape[2]
    between = (torch.arange(width - 1, dtype=torch.float64) + 0.5) / (width - 1)
    edges = torch.cat([between.new_zeros(1), between, between.new_ones(1)])
    return _one_value_at_the_poles(_across(radiance, edges, torch.linspace(0, 1, width + 1, dtype=torch.float64)))


def _columns_of(radiance: Tensor, height: int) -> Tensor:
    old, new = (torch.linspace(0, 1, width + 1, dtype=torch.float64) for width in (radiance.shape[2], 2 * height))
    return radiance if len(old) == len(new) else _across(radiance, old, new)


def _across(radiance: Tensor, edges: Tensor, new_edges: Tensor) -> Tensor:
    return _cell_means(radiance.transpose(1, 2), edges, new_edges).transpose(1, 2).contiguous()


def _cell_means(values: Tensor, edges: Tensor, new_edges: Tensor) -> Tensor:
    """(channels, m, k) float32: means over new cells along axis 1 of `values` (channels, n, k), constant in old ones.

    edges, new_edges  (n + 1,) and (m + 1,) float64, increasing, with common ends
    """
    cell = (torch.searchsorted(edges, new_edges, right=True) - 1).clamp(0, len(edges) - 2)
    inside = (new_edges - edges[cell])[:, None]
    means = []
    for channel in values:  # float64 of one at a time: probes may be large
        parts = channel.double() * edges.diff()[:, None]
        before = torch.cat([parts.new_zeros(1, parts.shape[1]), parts.cumsum(0)])[cell]
        integral = before + inside * channel.double()[cell]
        means.append((integral.diff(dim=0) / new_edges.diff()[:, None]).float())
    return torch.stack(means).clamp_min(0)  # below is rounding


def resize(radiance: Tensor, height: int) -> Tensor:
    """The map at another height, (channels, height, 2 height): means over each new texel's footprint.

    Footprints are those of `area_mean`, so that a lamp at a pole keeps its power too; the quadrature is one matrix
    per axis.
    """
    _, old_height, old_width = radiance.shape
    width = 2 * height
    steps = 16 * max(1, math.ceil(old_height / height))  # power within 0.1 %, also of single texels at a pole
    theta, weights = _strips(height, steps)
    y = theta.reshape(-1) * ((old_height - 1) / math.pi)
    row = y.floor().clamp(0, old_height - 2)
    by_row = _footprint_matrix(height, old_height, row.long(), row.long() + 1, y - row, weights.reshape(-1))

    offsets = (torch.arange(steps, dtype=torch.float64) + 0.5) / steps - 0.5
    x = (torch.arange(width, dtype=torch.float64)[:, None] + offsets + 0.5).reshape(-1)
    x = x * (old_width / width) - 0.5
    first = x.floor().long() % old_width
    second, fraction = (first + 1) % old_width, x - x.floor()
    by_column = _footprint_matrix(width, old_width, first, second, fraction, torch.ones_like(x))
    by_row, by_column = (m.to(radiance.device, radiance.dtype) for m in (by_row, by_column))
    return _one_value_at_the_poles(by_row @ radiance @ by_column.t())


def _one_value_at_the_poles(radiance: Tensor) -> Tensor:
    """All texels of a pole look in one direction: each becomes their mean, which changes no energy."""
    first, middle, last = radiance[:, :1], radiance[:, 1:-1], radiance[:, -1:]
    first, last = (row.mean(dim=2, keepdim=True).expand_as(row) for row in (first, last))
    return torch.cat([first, middle, last], dim=1)


def _footprint_matrix(
    new: int, old: int, first: Tensor, second: Tensor, fraction: Tensor, weights: Tensor
) -> Tensor:
    """(new, old): weighted means of linear interpolations between old samples; as many for each new one."""
    target = torch.arange(new).repeat_interleave(len(first) // new)
    matrix = torch.zeros(new, old, dtype=torch.float64)
    matrix.index_put_((target, first), weights * (1 - fraction), accumulate=True)
    matrix.index_put_((target, second), weights * fraction, accumulate=True)
    return matrix / matrix.sum(dim=1, keepdim=True)
