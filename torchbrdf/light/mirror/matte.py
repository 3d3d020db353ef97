"""Whether a ball mirrors what is around it: the picture of a matte one is smooth, and goes on in nothing beside it."""

import torch
from torch import Tensor

from torchbrdf.camera import Ball
from torchbrdf.light.mirror.pixels import grown
from torchbrdf.light.mirror.reflection import Reflection

_SMOOTH = 0.35
"""What third-order polynomials in the normal leave of a picture, over the picture: of mirrors in rooms and outdoors
0.49 to 0.78, of felt and satin paint 0.03 to 0.25, of glossy paint 0.3 to 0.46."""

_BRIGHTEST = 0.98
"""Quantile at which a picture is cut off: the image of a lamp is not smooth on a glossy ball either."""

_LIKE = 0.25
"""By how much, in the median, the logarithm of radiance jumps at most across the silhouette of a mirror."""

_APART = 2.0
"""Pixels to each side of the silhouette."""


def looks_matte(image: Tensor, shown: Tensor, ball: Ball) -> bool:
    """Whether a ball looks like one that is shaded, and not like a mirror.

    image  (3, H, W), over the ball's reflectance
    shown  (H, W) bool: pixels of the ball that hold finite radiance
    A mirror in a light as smooth as shading shows at its rim what lies beside it.
    """
    brightness = image.mean(0).double()
    return _roughness(brightness, shown, ball) < _SMOOTH and _jump(brightness, ball) > _LIKE


def _roughness(brightness: Tensor, shown: Tensor, ball: Ball) -> float:
    row, column = shown.nonzero(as_tuple=True)
    x, y, z = Reflection(ball).normals_at(torch.stack([column, row], -1).double() + 0.5).unbind(-1)
    powers = [x**i * y**j * z**k for i in range(4) for j in range(4 - i) for k in range(2) if i + j + k <= 3]
    seen = brightness[shown]
    seen = seen.clamp_max(seen.quantile(_BRIGHTEST) if len(seen) < 1 << 24 else seen.max())
    design = torch.stack(powers, -1)
    smooth = design @ torch.linalg.lstsq(design, seen[:, None]).solution[:, 0]
    return float((seen - smooth).norm() / seen.norm().clamp_min(torch.finfo(seen.dtype).tiny))


def _jump(brightness: Tensor, ball: Ball) -> float:
    """Infinite where nothing is seen beside the ball."""
    height, width = brightness.shape
    inner, outer = (grown(ball, by).outline().floor().long() for by in (-_APART, _APART))
    within = torch.ones(len(inner), dtype=torch.bool)
    for places in (inner, outer):
        within &= (places[:, 0] >= 0) & (places[:, 0] < width) & (places[:, 1] >= 0) & (places[:, 1] < height)
    inside, beside = (brightness[places[within, 1], places[within, 0]] for places in (inner, outer))
    both = torch.isfinite(inside) & torch.isfinite(beside) & (inside > 0) & (beside > 0)
    if not bool(both.any()):
        return float("inf")
    return float((inside[both] / beside[both]).log().abs().median())
