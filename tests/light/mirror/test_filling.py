"""What is not seen is continued from around it."""

import torch

from probes import texel_directions
from torchbrdf.light.mirror.filling import filled
from torchbrdf.light.mirror.unwrapping import Seen


def cap(height: int, towards: tuple[float, float, float], cosine: float) -> torch.Tensor:
    return texel_directions(height) @ torch.nn.functional.normalize(torch.tensor(towards), dim=0) > cosine


def test_what_is_seen_stays():
    radiance = torch.rand(3, 32, 64, generator=torch.Generator().manual_seed(0))
    hole = cap(32, (0, 0.2, -1), 0.9)
    found = filled(Seen(torch.where(hole, 0.0, radiance), (~hole).float()))
    assert torch.equal(found[:, ~hole], radiance[:, ~hole])


def test_a_hole_lies_between_what_is_around_it():
    radiance = torch.rand(3, 32, 64, generator=torch.Generator().manual_seed(0)) + 0.5
    hole = cap(32, (0, 0.2, -1), 0.9)
    found = filled(Seen(torch.where(hole, 0.0, radiance), (~hole).float()))
    assert float(found[:, hole].min()) > 0.5
    assert float(found[:, hole].max()) < 1.5


def test_a_harmonic_function_is_continued():
    """log tan(theta / 2), about an axis, across the seam in azimuth, and across a pole."""
    axis = torch.nn.functional.normalize(torch.tensor([0.2, 0.3, 1.0]), dim=0)
    cosine = texel_directions(64) @ axis
    harmonic = (((1 + cosine) / (1 - cosine).clamp_min(1e-6)).log() / 2).expand(3, -1, -1)
    for towards in ((0.9, 0.1, 0.1), (0.0, 1.0, 0.0), (-0.4, -0.9, 0.1)):
        hole = cap(64, towards, 0.93)
        found = filled(Seen(torch.where(hole, 0.0, harmonic), (~hole).float()))
        assert float((found - harmonic)[:, hole].abs().max()) < 0.02 * float(harmonic[:, hole].abs().max() + 1)


def test_nothing_to_fill():
    radiance = torch.rand(3, 8, 16)
    assert torch.equal(filled(Seen(radiance, torch.ones(8, 16))), radiance)
