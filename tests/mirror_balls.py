"""Photographs of mirror balls, traced ray by ray, and smooth light for them."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from torchbrdf.camera import Ball, PinholeCamera

CAMERA = PinholeCamera.of_fov((120, 180), 30)
BALL = Ball(CAMERA, (0.08, -0.01, -1.0), 8.0)

_PARTS = 4


def scene(d: Tensor) -> Tensor:
    """A smooth asymmetric radiance (..., 3) of directions (..., 3), above 0.2."""
    x, y, z = d.unbind(-1)
    return torch.stack([1.5 + x + 0.3 * y * z, 1.5 + y + 0.3 * x * z, 1.5 + z + 0.3 * x * y], -1)


def room(d: Tensor) -> Tensor:
    """Windows and lamps (..., 3) of many sizes in directions (..., 3)."""
    generator = torch.Generator().manual_seed(3)
    places = torch.nn.functional.normalize(torch.randn(40, 3, generator=generator, dtype=torch.float64), dim=-1)
    widths = 8 + 60 * torch.rand(40, generator=generator, dtype=torch.float64)
    colours = 3 * torch.rand(40, 3, generator=generator, dtype=torch.float64)
    away = torch.addmm(-widths.float(), d.reshape(-1, 3).float(), (widths[:, None] * places).T.float())
    lit = torch.exp(away.clamp_min(-40)) @ colours.float()  # smaller numbers are denormal, and slow
    return 0.1 + lit.reshape(d.shape)


def photographed(
    ball: Ball,
    radiance_of: Callable[[Tensor], Tensor] = scene,
    reflectance: Callable[[Tensor], Tensor] | None = None,
) -> Tensor:
    """(3, H, W): means over the pixels of what a ray meets: the ball, whose rays go on mirrored, or the scene.

    reflectance  of angles of incidence (...) in radians: (..., 3)
    """
    height, width = ball.camera.size
    offsets = (torch.arange(_PARTS, dtype=torch.float64) + 0.5) / _PARTS
    y = (torch.arange(height)[:, None] + offsets).reshape(-1)
    x = (torch.arange(width)[:, None] + offsets).reshape(-1)
    rays = ball.camera.rays(torch.stack(torch.broadcast_tensors(x, y[:, None]), -1))
    middle = torch.tensor(ball.direction, dtype=torch.float64) / math.sin(math.radians(ball.radius_deg))
    along = rays @ middle
    root = along**2 - middle @ middle + 1
    on_ball = root > 0
    image = rays.new_empty(rays.shape)
    image[~on_ball] = radiance_of(rays[~on_ball]).to(image)
    rays = rays[on_ball]
    normals = (along - root.clamp_min(0).sqrt())[on_ball, None] * rays - middle
    cosine = -(rays * normals).sum(-1, keepdim=True)
    seen = radiance_of(rays + 2 * cosine * normals)
    if reflectance is not None:
        seen = seen * reflectance(torch.acos(cosine[..., 0].clamp(-1, 1)))
    image[on_ball] = seen.to(image)
    return image.reshape(height, _PARTS, width, _PARTS, 3).mean((1, 3)).permute(2, 0, 1).float()
