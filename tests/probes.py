"""Light probes of the tests, and how far one image is from another."""

import math

import torch
from torch import Tensor

from torchbrdf.light.latlong import directions_at
from torchbrdf.light.probe import LightProbe


def texel_directions(height: int) -> Tensor:
    """(H, 2 H, 3): the directions of a lat-long map."""
    y, x = torch.meshgrid(torch.arange(height), torch.arange(2 * height), indexing="ij")
    return directions_at(x, y, height, 2 * height)


def probe_of(radiance_of, height: int = 64) -> LightProbe:
    """A grey probe from a function of directions (..., 3)."""
    return LightProbe(radiance_of(texel_directions(height)).float().expand(3, height, 2 * height))


def lamps(height: int = 32, scale: float = 1.0) -> LightProbe:
    """Dim coloured light, a large and a small lamp."""
    d = texel_directions(height)
    near = torch.nn.functional.normalize(torch.tensor([0.4, 0.5, 0.75]), dim=0)
    far = torch.nn.functional.normalize(torch.tensor([-0.8, 0.2, 0.1]), dim=0)
    light = torch.stack([0.3 + 0.2 * d[..., 1], 0.3 + 0.1 * d[..., 0], 0.3 - 0.2 * d[..., 1]])
    light = light + torch.where(d @ near > math.cos(0.3), 20.0, 0.0)
    return LightProbe(scale * (light + torch.where(d @ far > math.cos(0.12), 300.0, 0.0)))


def relative(image: Tensor, reference: Tensor) -> float:
    """Relative RMS error."""
    return float(((image - reference).square().sum() / reference.square().sum()).sqrt())
