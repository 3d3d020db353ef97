"""A table under one directional light: the picture in which ringing, spikes and false highlights show.

Natural light blurs a BRDF; a directional light shows its values one by one. The light of angle a lies in
direction (sin a, 0, cos a): it turns about +Y from the camera (0 degrees, +Z) over image right (90) to behind
the object (180). [CBP21, figs. 2-6] look at 0 and 136 degrees; the paper does not say about which axis.
"""

from collections.abc import Sequence
from math import cos, isfinite, radians, sin

import torch
from torch import Tensor

from torchbrdf.arguments import check_types, warn_of_lost_gradient, whole
from torchbrdf.brdf import MerlTable, linear_lookups
from torchbrdf.view import View

_BLOCK = 1 << 16
"""Points looked up at once."""


def render_directional(
    table: MerlTable,
    view: View,
    angle_deg: float | None = None,
    *,
    direction: Tensor | None = None,
    irradiance: float = 1.0,
    subpixels: int = 4,
) -> Tensor:
    """Radiance (3, H, W) of a view under one directional light, 0 outside the mask.

    radiance = f_r(w_i, w_o) cos(theta_i) irradiance, averaged over a pixel by subpixels x subpixels points.
    angle_deg   the light turned about +Y: 0 from the camera, 90 from image right, 136 from behind
    direction   (3,) towards the light in world space, any length; instead of angle_deg
    irradiance  of a surface that faces the light; with pi a white Lambertian surface has radiance 1 there
    subpixels   points along a side of a pixel; f_r is interpolated linearly between cells
    Differentiable in the table's values. Raises ValueError where not exactly one of angle_deg and direction is given,
    or a value or a type makes no sense.
    """
    check_types("tb.render_directional", table=(table, MerlTable), view=(view, View))
    return directional_pictures([table], view, angle_deg, direction, irradiance, subpixels)[0]


def directional_pictures(
    tables: Sequence[MerlTable],
    view: View,
    angle_deg: float | None = None,
    direction: Tensor | None = None,
    irradiance: float = 1.0,
    subpixels: int = 4,
) -> Tensor:
    """(K, 3, H, W): `render_directional` of several tables, in little more than the time of one."""
    w_i = light_direction(angle_deg, direction)
    if not 0 < irradiance < float("inf"):
        raise ValueError(f"irradiance must be positive and finite, got {irradiance}")
    subpixels = whole("subpixels", subpixels)
    if subpixels < 1:
        raise ValueError(f"subpixels must be at least 1, got {subpixels}")
    steps = (torch.arange(subpixels, dtype=torch.float64) + 0.5) / subpixels
    v, u = (c.reshape(1, -1) for c in torch.meshgrid(steps, steps, indexing="ij"))
    pixels = view.pixels.cpu()
    packed = torch.empty(len(tables), 3, len(pixels), dtype=torch.float64)
    for chunk in torch.arange(len(pixels)).split(max(1, _BLOCK // subpixels**2)):
        shape = (len(chunk), subpixels**2)
        points = view.surface(pixels[chunk], u.expand(shape), v.expand(shape))
        normal, w_o = (vectors.double().movedim(0, -1) for vectors in (points.normals, points.view_dirs))
        local_i, local_o = to_local(normal, w_i.expand_as(normal)), to_local(normal, w_o)
        received = local_i[..., 2:].clamp_min(0)
        lit = view.visibility(points, w_i[:, None, None].expand(3, *shape))
        received = received if lit is None else received * lit[..., None]
        for i, f_r in enumerate(linear_lookups(tables, local_i, local_o)):
            packed[i][:, chunk] = (f_r * received).mean(1).T
    return view.unpack((irradiance * packed).float())


def light_direction(angle_deg: float | None = None, direction: Tensor | None = None) -> Tensor:
    """(3,) float64: the unit vector towards the light; see `render_directional`."""
    if (angle_deg is None) == (direction is None):
        raise ValueError("give either angle_deg or direction for the light, and not both")
    if angle_deg is not None:
        if not isfinite(angle_deg):
            raise ValueError(f"angle_deg must be finite, got {angle_deg}")
        angle = radians(angle_deg)
        return torch.tensor([sin(angle), 0.0, cos(angle)], dtype=torch.float64)
    vector = torch.as_tensor(direction)
    if vector.shape != (3,):
        raise ValueError(f"direction of the light must be (3,), got {tuple(vector.shape)}")
    warn_of_lost_gradient(vector, "the direction of the light", 'table.lookup(w_i, w_o, "linear") carries it')
    vector = vector.detach().cpu().double()
    length = torch.linalg.vector_norm(vector)
    if not (torch.isfinite(length) and length > 0):
        raise ValueError(f"direction of the light must be finite and not zero, got {vector.tolist()}")
    return vector / length


def to_local(normal: Tensor, w: Tensor) -> Tensor:
    """World directions w (..., 3) in a frame whose +Z is the unit normal (..., 3).

    The frame's turn about the normal is arbitrary but depends on the normal alone: isotropic BRDFs do not see it.
    """
    steep = normal[..., 2:].abs() > 0.9
    helper = torch.where(steep, normal.new_tensor([1.0, 0.0, 0.0]), normal.new_tensor([0.0, 0.0, 1.0]))
    t = torch.nn.functional.normalize(torch.linalg.cross(helper, normal), dim=-1)
    b = torch.linalg.cross(normal, t)
    return torch.stack([(axis * w).sum(-1) for axis in (t, b, normal)], dim=-1)
